import sys

import numpy as np
import pytest

from esd.common import InputError
from esd.mesh.io.meshes import read_arrays, read_mesh
from esd.mesh.shapes import torus

MESH = torus(7, 5)


def is_the_mesh(path, tolerance=1e-6):  # some hold 32 bits
    back = read_mesh(path)
    np.testing.assert_array_equal(back.faces, MESH.faces)
    np.testing.assert_allclose(back.vertices, MESH.vertices, atol=tolerance)


@pytest.mark.parametrize("suffix", ["vtk", "vtu", "msh"])
def test_meshio_reads(tmp_path, suffix, capsys):
    meshio = pytest.importorskip("meshio", reason="meshio is not installed")
    options = {"file_format": "gmsh"} if suffix == "msh" else {}
    meshio.Mesh(MESH.vertices, [("triangle", MESH.faces)]).write(
        tmp_path / f"m.{suffix}", **options
    )
    is_the_mesh(tmp_path / f"m.{suffix}")
    (tmp_path / f"bad.{suffix}").write_text("hello\n")
    with pytest.raises(InputError, match=rf"bad.{suffix}'"):
        read_arrays(tmp_path / f"bad.{suffix}")
    assert capsys.readouterr() == ("", "")  # meshio prints what is wrong


@pytest.mark.parametrize("content", [" (2", "(2", "(10 (0 1"])
def test_gmsh_files_that_are_cut_end(tmp_path, content):
    pytest.importorskip("meshio", reason="meshio is not installed")
    (tmp_path / "m.msh").write_text(content)  # meshio's reader of ANSYS never came to an end
    with pytest.raises(InputError, match=r"m.msh'"):
        read_arrays(tmp_path / "m.msh")


def test_nibabel_reads(tmp_path):
    nibabel = pytest.importorskip("nibabel", reason="nibabel is not installed")
    arrays = [
        nibabel.gifti.GiftiDataArray(MESH.vertices.astype("f4"), intent="NIFTI_INTENT_POINTSET"),
        nibabel.gifti.GiftiDataArray(MESH.faces.astype("i4"), intent="NIFTI_INTENT_TRIANGLE"),
    ]
    nibabel.save(nibabel.gifti.GiftiImage(darrays=arrays), tmp_path / "m.surf.gii")
    is_the_mesh(tmp_path / "m.surf.gii")
    nibabel.save(nibabel.gifti.GiftiImage(darrays=[]), tmp_path / "v.gii")
    with pytest.raises(InputError, match="values and no surface"):
        read_arrays(tmp_path / "v.gii")
    nibabel.freesurfer.write_geometry(str(tmp_path / "lh.pial"), MESH.vertices, MESH.faces)
    is_the_mesh(tmp_path / "lh.pial")
    (tmp_path / "lh.white").write_text("no")
    with pytest.raises(InputError, match="no surface of FreeSurfer"):
        read_arrays(tmp_path / "lh.white")


def test_without_the_extra_the_message_names_it(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "meshio", None)
    (tmp_path / "m.vtk").touch()
    with pytest.raises(InputError, match=r"pip install 'embedded-spectral-descriptors\[formats\]'"):
        read_arrays(tmp_path / "m.vtk")
