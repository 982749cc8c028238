import pytest

from esd.common import InputError
from esd.datasets.collection import Collection, read_pairs
from esd.datasets.folder import folder_collection
from esd.datasets.splits import split_by_subject
from esd.mesh.io.meshes import write_mesh
from esd.mesh.shapes import grid, torus


@pytest.fixture
def registered(tmp_path):
    for name in ("tr_reg_000", "tr_reg_001", "tr_reg_010", "tr_reg_020"):
        write_mesh(torus(6, 5), tmp_path / f"{name}.off")
    return tmp_path


@pytest.fixture
def remeshed(tmp_path):
    (tmp_path / "shapes").mkdir()
    (tmp_path / "corres").mkdir()
    for name, rows in (("cat0", 5), ("cat1", 6), ("wolf0", 7)):
        write_mesh(grid(4, rows), tmp_path / "shapes" / f"{name}.off")
        (tmp_path / "corres" / f"{name}.vts").write_text("3\n1\n20\n")
    (tmp_path / "corres" / "cat0.sym.vts").write_text("1\n3\n20\n")
    return tmp_path


def test_selection_and_splits(registered):
    collection = folder_collection(registered)
    assert len(collection.including("tr_reg_00*, tr_reg_020").shapes) == 3
    with pytest.raises(InputError, match=r"No shape of .* matches 'x'"):
        collection.including("x")
    with pytest.raises(InputError, match="has no shape 'x'"):
        collection["x"]
    kept, held = split_by_subject(collection, held_out=1, seed=3)
    assert set(kept.subjects) | set(held.subjects) == set(collection.subjects)
    assert not set(kept.subjects) & set(held.subjects)
    with pytest.raises(InputError, match="`held_out` must be from 1 to 2"):
        split_by_subject(collection, held_out=3)
    with pytest.raises(InputError, match="is left without"):
        collection.excluding_subjects(collection.subjects)
    with pytest.raises(InputError, match="no two shapes"):
        Collection("one", collection.shapes[:1]).pairs()


def test_pairs_files(registered, remeshed, tmp_path):
    collection = folder_collection(tmp_path)  # shapes/ comes first
    file = tmp_path / "pairs"
    file.write_text("cat0\tcat1\n\n")
    assert [(s.name, t.name) for s, t in read_pairs(file, collection)] == [("cat0", "cat1")]
    for text, message in [
        ("cat0 cat1\n", "line 1: expected two shape names"),
        ("cat0\twolf0\n", "do not correspond"),
        ("cat0\tdog\n", "has no shape 'dog'"),
        ("\n", "lists no pair"),
    ]:
        file.write_text(text)
        with pytest.raises(InputError, match=message):
            read_pairs(file, collection)
    with pytest.raises(InputError, match="There is no file"):
        read_pairs(tmp_path / "none", collection)
    file.write_bytes(b"cat0\t\xff\n")
    with pytest.raises(InputError, match=r"pairs' cannot be read: byte 6 of it is no text"):
        read_pairs(file, collection)
