import csv
import json
import re
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from esd.common import InputError
from esd.learning.model import Layer, Model, raw_model, save_model
from esd.matching import adapt
from esd.matching.batch import PairOfFiles, match_files
from esd.matching.match import match, prepared, working_features
from esd.mesh.io.meshes import write_mesh
from esd.mesh.mesh import PointCloud
from esd.parallel import THIS_PROCESS
from knobbed import RECIPE, knobbed, truth

torch = pytest.importorskip("torch", reason="adapting needs the extra `train`")


SETTINGS = {"full": True, "candidates": ["embedding"], "refine": False, "mirror": "no"}


@pytest.fixture(autouse=True)
def few_steps(monkeypatch):
    monkeypatch.setattr("esd.learning.adapt._STEPS", 4)


@pytest.fixture(scope="module")
def untrained() -> Model:
    generator = np.random.default_rng(0)
    widths = (RECIPE.width, 32, 16)
    layers = tuple(
        Layer(
            generator.uniform(-1, 1, (b, a)).astype(np.float32) / np.float32(np.sqrt(a)),
            np.zeros(b, dtype=np.float32),
        )
        for a, b in pairwise(widths)
    )
    layers[0].weight[:, 3:] = 0.0  # it knows little
    zero, one = np.zeros(RECIPE.width), np.ones(RECIPE.width)
    return Model("untrained", RECIPE, zero, one, layers, limit=8.0, unit_length=True)


def error(found, source: int, target: int) -> float:
    there = knobbed(target).vertices
    away = there[found.target_index] - there[truth(source, target)]
    return float(np.linalg.norm(away, axis=1).mean())


def test_a_model_adapted_to_a_pair_maps_it_better(untrained):
    meshes = knobbed(1), knobbed(2)
    settings = {"model": untrained, **SETTINGS}
    plain = match(*meshes, **settings)
    found = match(*meshes, adapt=True, **settings)
    adaptation = found.judgement.adaptation
    assert plain.judgement.adaptation is None
    assert adaptation.is_kept
    assert adaptation.cost_after < adaptation.cost_before
    assert adaptation.seconds > 0
    assert "the cost fell from" in adaptation.in_a_line()
    assert error(found, 1, 2) < 0.7 * error(plain, 1, 2)


def test_an_adaptation_that_the_judge_finds_worse_is_dropped(untrained, monkeypatch):
    meshes = knobbed(1), knobbed(2)
    settings = {"model": untrained, **SETTINGS}
    plain = match(*meshes, **settings)
    costs = iter([1.0, 2.0])
    monkeypatch.setattr(adapt, "_mean_cost", lambda *_: next(costs))
    found = match(*meshes, adapt=True, **settings)
    assert not found.judgement.adaptation.is_kept
    assert "gave nothing: the cost rose from 1.00 to 2.00" in found.judgement.adaptation.in_a_line()
    # another number of threads rounds otherwise, and few matches of this model are clear
    assert (found.target_index == plain.target_index).mean() > 0.95


def test_landmarks_are_learned_from(untrained):
    vertices = np.array([3, 100, 250, 400, 600])
    marks = np.stack([vertices, truth(1, 2)[vertices]], axis=1)
    found = match(
        knobbed(1), knobbed(2), model=untrained, landmarks=marks, full=True, adapt=True, mirror="no"
    )
    assert found.judgement.adaptation is not None
    assert error(found, 1, 2) < 0.5


def test_mirror_images_are_adapted_to(untrained):
    mesh = knobbed(1)
    image = replace(mesh, vertices=mesh.vertices * [-1, 1, 1], faces=mesh.faces[:, ::-1])
    settings = {"model": untrained, **SETTINGS, "adapt": True}
    found = match(image, knobbed(2), **{**settings, "mirror": "yes"})
    usual = match(mesh, knobbed(2), **settings)
    assert found.judgement.is_mirrored
    assert error(found, 1, 2) == pytest.approx(error(usual, 1, 2), rel=0.3)


def test_a_batch_adapts_the_model_to_each_pair(untrained, tmp_path):
    files = [tmp_path / f"{seed}.ply" for seed in (1, 2)]
    for seed, file in zip((1, 2), files, strict=True):
        write_mesh(knobbed(seed), file)
    maps = {}
    for is_adapted in (False, True):
        output = tmp_path / f"{is_adapted}.csv"
        done = match_files(
            (PairOfFiles(*files, output),),
            model=untrained,
            adapt=is_adapted,
            **SETTINGS,
            workers=THIS_PROCESS,
        )
        assert [each.failure for each in done] == [None]
        with output.open(newline="") as file:
            maps[is_adapted] = [row["target"] for row in csv.DictReader(file)]
    assert maps[True] != maps[False]


def test_what_cannot_be_adapted_is_refused(untrained, monkeypatch):
    mesh = knobbed(1)
    cloud = PointCloud(mesh.vertices)
    hks = raw_model("hks")
    points = working_features(prepared(cloud), model=hks)
    with pytest.raises(InputError, match="Adapting needs meshes; these are points"):
        adapt.adapted_model(points, points, model=hks)
    with pytest.raises(InputError, match="'hks' cannot learn without correspondences"):
        match(mesh, mesh, model=hks, adapt=True)
    monkeypatch.setattr(adapt, "find_spec", lambda _: None)
    with pytest.raises(InputError, match=r"Adapting needs torch: pip install .*\[train\]"):
        match(mesh, mesh, model=untrained, adapt=True)


@pytest.fixture
def files(untrained, tmp_path):
    save_model(untrained, tmp_path / "untrained")
    for seed in (1, 2):
        write_mesh(knobbed(seed), tmp_path / f"{seed}.ply")
    return tmp_path / "1.ply", tmp_path / "2.ply", "--model", tmp_path / "untrained"


def test_the_command_says_what_adapting_cost_and_gave(run, files, tmp_path):
    options = ("--full", "--candidates", "embedding", "--mirror", "no", "--no-refine", "--adapt")
    done = run("match", *files, "-o", tmp_path / "map.csv", *options)
    assert re.search(r"Adapting the model took \d+ s; the cost fell from", done.stdout)
    done = run("match", *files, "-o", tmp_path / "map.csv", *options, "--json", "--force")
    adaptation = json.loads(done.stdout)["adaptation"]
    assert adaptation["is_kept"]
    assert adaptation["cost_after"] < adaptation["cost_before"]


def test_a_model_that_cannot_be_adapted_is_refused_before_anything_is_computed(
    run, files, tmp_path
):
    output = tmp_path / "map.csv"
    done = run("match", *files[:2], "-o", output, "--model", "paper-hks", "--adapt", expect=1)
    assert "'paper-hks' cannot learn without correspondences" in done.stderr
    (tmp_path / "pairs.csv").write_text("source,target\n1.ply,2.ply\n")
    done = run("batch", tmp_path / "pairs.csv", "--model", "paper-hks", "--adapt", expect=1)
    assert "'paper-hks' cannot learn without correspondences" in done.stderr
    assert not output.exists()
