from functools import partial
from pathlib import Path

import numpy as np
import pytest

import esd.matching.batch as batch
from esd.common import InputError
from esd.descriptors.recipe import Descriptor, Recipe
from esd.learning.model import Model
from esd.matching.batch import match_files, read_pairs_of_files
from esd.matching.correspondence import load_map
from esd.matching.match import match
from esd.mesh.io.meshes import write_mesh
from esd.mesh.mesh import Mesh
from esd.parallel import Workers

MODEL = Model(
    "raw", Recipe((Descriptor("wks", 8),), eigenpairs=20), np.zeros(8), np.ones(8), margin=1e6
)


@pytest.fixture
def folder(tmp_path, blob) -> Path:
    for i, name in enumerate("abc"):
        write_mesh(
            Mesh(blob.vertices * (1 + 0.1 * i * np.arange(3)), blob.faces), tmp_path / f"{name}.off"
        )
    (tmp_path / "bad.off").write_text("OFF\n")
    (tmp_path / "pairs.csv").write_text(
        "source,target,output\na.off,b.off,\nb.off, a.off,ba.npy\na.off,bad.off,\nb.off,c.off,\n"
    )
    return tmp_path


def test_a_batch_gives_the_maps_of_its_pairs_and_describes_each_shape_once(folder, monkeypatch):
    pairs = read_pairs_of_files(folder / "pairs.csv", folder=folder)
    computed, steps = [], []
    for name in ("prepared", "working_features"):
        compute = getattr(batch, name)
        counted = partial(lambda f, *a, **k: computed.append(f) or f(*a, **k), compute)
        monkeypatch.setattr(batch, name, counted)
    done = list(
        match_files(pairs, model=MODEL, workers=Workers(1), on_step=lambda: steps.append(1))
    )
    assert len(computed) == 4 + 3  # one cannot be read
    assert len(steps) == 4 + 4
    failed = [each for each in done if each.failure]
    assert [each.pair.target.name for each in failed] == ["bad.off"]
    assert "bad.off" in failed[0].failure
    for each in done:
        if not each.failure:
            single = match(each.pair.source, each.pair.target, model=MODEL)
            count = len(single.target_index)
            found = load_map(each.pair.output, source_count=count, target_count=count)
            np.testing.assert_array_equal(found.target_index, single.target_index)
            assert each.matched == len(single.target_index)
    assert {file.name for file in folder.glob("*-*")} == {"a-b.csv", "b-c.csv"}
    assert (folder / "ba.npy").exists()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a,b\n", "must have the columns source,target"),
        ("source,target\n", "lists no pair"),
        ("source,target\na.off,\n", "pair 1: a source and a target are needed"),
        ("source,target\na.off,b.off\na.off,b.off\n", "several maps to"),
        ("source,target,output\na.off,b.off,m.xyz\n", "a map's file ends in"),
        ("source,target\n\x00\xff", "is no CSV file"),
        (
            "source,target\na.off,b\x00.off\n",
            r"pair 1: a name holds a character of code 0|line contains NUL",
        ),  # the latter up to Python 3.10
        (
            "source,target,source_landmarks\na.off,b.off,a.csv\n",
            "landmarks of both shapes, or none",
        ),
        (
            "source,target,source_landmarks,target_landmarks\na.off,b.off,a.csv,b.csv\n",
            "pair 1: there is no file '.*a.csv'",
        ),
    ],
)
def test_bad_lists_of_pairs_are_refused(tmp_path, text, message):
    (tmp_path / "p.csv").write_bytes(text.encode("latin-1"))
    with pytest.raises(InputError, match=message):
        read_pairs_of_files(tmp_path / "p.csv")
    with pytest.raises(InputError, match="There is no file"):
        read_pairs_of_files(tmp_path / "q.csv")


def test_a_batch_takes_landmarks_of_its_pairs(folder):
    for name, step in (("a", 0), ("b", 1)):
        lines = [f"{i},{100 * i + step}" for i in range(4)]
        (folder / f"{name}.csv").write_text("\n".join(["name,vertex", *lines]))
    (folder / "pairs.csv").write_text(
        "source,target,source_landmarks,target_landmarks\na.off,b.off,a.csv,b.csv\n"
    )
    (pair,) = read_pairs_of_files(folder / "pairs.csv", folder=folder)
    (done,) = match_files((pair,), model=MODEL, workers=Workers(1))
    assert done.failure is None
    vertices = 100 * np.arange(4)
    landmarks = np.stack([vertices, vertices + 1], axis=1)
    single = match(pair.source, pair.target, model=MODEL, landmarks=landmarks)
    count = len(single.target_index)
    found = load_map(pair.output, source_count=count, target_count=count)
    np.testing.assert_array_equal(found.target_index, single.target_index)
    plain = match(pair.source, pair.target, model=MODEL)
    assert (found.target_index != plain.target_index).any()


def test_a_batch_says_what_was_not_repaired(folder, blob):
    bowl = Mesh(blob.vertices, blob.faces[blob.vertices[blob.faces, 0].max(axis=1) < 0.5])
    write_mesh(bowl, folder / "bowl.off")
    (folder / "pairs.csv").write_text(
        "source,target\na.off,b.off\nbowl.off,b.off\nb.off,bowl.off\n"
    )
    pairs = read_pairs_of_files(folder / "pairs.csv", folder=folder)
    done = match_files(pairs, model=MODEL, workers=Workers(1))
    said = {each.pair.source.stem: each.not_repaired for each in done}
    assert said["a"] == ""
    assert said["bowl"].endswith("in the source")
    assert said["b"].endswith("in the target")
    assert "hole" in said["b"]


def test_a_wrong_limit_of_the_cache_is_refused_once(folder, monkeypatch):
    monkeypatch.setenv("ESD_CACHE_LIMIT", "much")
    pairs = read_pairs_of_files(folder / "pairs.csv", folder=folder)
    with pytest.raises(InputError, match=r"^ESD_CACHE_LIMIT must be a number of gigabytes"):
        list(match_files(pairs, model=MODEL, workers=Workers(1)))


def test_a_batch_by_way_of_coarse_copies_gives_the_maps_of_its_pairs(folder):
    pairs = read_pairs_of_files(folder / "pairs.csv", folder=folder)[:1]
    (done,) = match_files(pairs, model=MODEL, coarse=300, workers=Workers(1))
    single = match(pairs[0].source, pairs[0].target, model=MODEL, coarse=300)
    count = len(single.target_index)
    found = load_map(pairs[0].output, source_count=count, target_count=count)
    np.testing.assert_array_equal(found.target_index, single.target_index)
    assert done.matched == count == 512
    with pytest.raises(InputError, match="are not one-to-one"):
        list(match_files(pairs, model=MODEL, coarse=300, one_to_one=True))
