import numpy as np
import pytest
import typer

from esd.cli.shapes import landmark_pairs, read_drawable, read_shape
from esd.common import InputError
from esd.mesh.io.meshes import write_mesh
from esd.mesh.mesh import PointCloud
from esd.mesh.shapes import torus


def test_a_shape_keeps_all_its_vertices(tmp_path):
    mesh = torus(6, 5)
    write_mesh(mesh, tmp_path / "a.off")
    assert len(read_shape(tmp_path / "a.off").vertices) == 30
    assert len(read_drawable(tmp_path / "a.off").faces) == 60
    np.savetxt(tmp_path / "p.xyz", mesh.vertices)
    assert isinstance(read_shape(tmp_path / "p.xyz"), PointCloud)
    with pytest.raises(InputError, match=r"p.xyz.*no face between finite vertices"):
        read_drawable(tmp_path / "p.xyz")


def test_flat_faces_cannot_be_drawn(tmp_path):
    (tmp_path / "flat.off").write_text("OFF\n3 1 0\n0 0 0\n1 0 0\n2 0 0\n3 0 1 2\n")
    with pytest.raises(InputError, match=r"flat.off.*Its faces have no area"):
        read_drawable(tmp_path / "flat.off")


def test_landmarks_are_in_one_file_or_two(tmp_path):
    assert landmark_pairs([], tmp_path, tmp_path) == ((), None)
    with pytest.raises(typer.BadParameter, match="--landmarks takes one file or two"):
        landmark_pairs([tmp_path] * 3, tmp_path, tmp_path)
