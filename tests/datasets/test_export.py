from dataclasses import replace

import numpy as np
import pytest

from esd.common import InputError
from esd.datasets.bodies import (
    PARTS,
    bodies,
    part_labels,
)
from esd.datasets.collection import Collection, Shape
from esd.datasets.export import export_folder, labels_on
from esd.datasets.folder import folder_collection, read_vts
from esd.mesh.shapes import icosphere
from esd.parallel import THIS_PROCESS


@pytest.fixture(scope="module")
def remeshed():
    return bodies(vertex_count=2000)


def test_export_and_reading_the_folder_are_inverse(tmp_path, remeshed):
    some = remeshed.including("s0[12]_p03")
    export_folder(some, tmp_path / "out", part_names=PARTS, part_labels=part_labels())
    found = folder_collection(tmp_path / "out")
    assert [s.name for s in found.shapes] == [s.name for s in some.shapes]
    assert found.subjects == some.subjects
    for one, two in zip(found.shapes, some.shapes, strict=True):
        # metres; some digits of small numbers are lost in text
        assert np.abs(one.mesh().vertices - two.mesh().vertices).max() < 1e-15
        assert (one.mesh().faces == two.mesh().faces).all()
        assert (one.correspondence() == two.correspondence()).all()
        assert (one.symmetric() == two.symmetric()).all()
        labels = np.loadtxt(tmp_path / "out" / "parts" / f"{one.name}.txt", dtype=int)
        assert (labels == labels_on(two, part_labels())).all()
        # points of two parts may share a vertex, of which there are few, and it has one label
        assert (one.parts() == two.parts()).mean() > 0.95
    names = (tmp_path / "out" / "parts" / "names.txt").read_text().splitlines()
    assert tuple(names) == PARTS


def test_export_counts_vertices_from_one_and_writes_only_what_is_known(tmp_path):
    ball = icosphere(1)
    shape = Shape("ball", "ball", "ball", lambda: ball, lambda: np.arange(5))
    export_folder(Collection("balls", (shape,)), tmp_path / "out", suffix=".ply")
    assert (tmp_path / "out/corres/ball.vts").read_text() == "1\n2\n3\n4\n5\n"
    assert (read_vts(tmp_path / "out/corres/ball.vts") == np.arange(5)).all()
    assert (tmp_path / "out/shapes/ball.ply").is_file()
    assert not (tmp_path / "out/corres/ball.sym.vts").exists()
    assert not (tmp_path / "out/parts").exists()


def test_export_names_what_it_cannot_write(tmp_path):
    ball = icosphere(1)
    shape = Shape("ball", "ball", "ball", lambda: ball, lambda: np.array([3, -1]))
    collection = Collection("balls", (shape,))
    with pytest.raises(InputError, match=r"must be one of .*; got '.xyz'"):
        export_folder(collection, tmp_path / "out", suffix=".xyz")
    missing = replace(shape, correspondence=lambda: np.full(2, 99))
    with pytest.raises(InputError, match="'ball': IndexError"):
        export_folder(
            Collection("balls", (missing,)), tmp_path / "no", part_labels=np.zeros(2, dtype=int)
        )
    export_folder(collection, tmp_path / "out", workers=THIS_PROCESS)
    back = folder_collection(tmp_path / "out")["ball"].correspondence()
    np.testing.assert_array_equal(back, [3, -1])
    with pytest.raises(InputError, match="a label for each of the 2 points"):
        labels_on(shape, np.zeros(3, dtype=np.int64))
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot be written to"):
        export_folder(collection, tmp_path / "file")


def test_labels_of_vertices_without_a_point_are_those_of_the_nearest():
    ball = icosphere(2)
    poles = np.array([ball.vertices[:, 2].argmin(), -1, ball.vertices[:, 2].argmax()])
    shape = Shape("ball", "ball", "ball", lambda: ball, lambda: poles)
    found = labels_on(shape, np.array([4, 5, 6]))
    north = ball.vertices[:, 2] > 0.1
    assert (found[north] == 6).all()
    assert (found[ball.vertices[:, 2] < -0.1] == 4).all()
