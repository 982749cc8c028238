"""Formats that other packages read, points, and files that gzip packed."""

import gzip
import sys
import zipfile

import numpy as np
import pytest

from esd.common import InputError
from esd.mesh.io.meshes import read_arrays, read_mesh, write_mesh
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


def test_packed_files_are_read(tmp_path):
    write_mesh(MESH, tmp_path / "m.ply")
    (tmp_path / "m.ply.gz").write_bytes(gzip.compress((tmp_path / "m.ply").read_bytes()))
    is_the_mesh(tmp_path / "m.ply.gz", 0)
    (tmp_path / "m.ply.gz").write_bytes(b"hello")
    with pytest.raises(InputError, match="cannot be unpacked"):
        read_arrays(tmp_path / "m.ply.gz")


def test_files_that_unpack_to_too_much_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("esd.mesh.io.meshes._LARGEST_UNPACKED", 2**20)
    monkeypatch.setattr("esd.mesh.io.extra._LARGEST", 2**20)
    (tmp_path / "m.ply.gz").write_bytes(gzip.compress(bytes(2**22)))
    with pytest.raises(InputError, match="unpacks to more than 1 GiB; unpack"):
        read_arrays(tmp_path / "m.ply.gz")
    pytest.importorskip("lxml", reason="lxml is not installed")
    pytest.importorskip("networkx", reason="networkx is not installed")
    with zipfile.ZipFile(tmp_path / "m.3mf", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("3D/3dmodel.model", bytes(2**22))
    with pytest.raises(InputError, match="unpacks to more than 1 GiB; simplify"):
        read_arrays(tmp_path / "m.3mf")


def pcd(form, body, fields="x y z", count=2):
    names = fields.split()
    return (
        f"# .PCD v0.7\nVERSION 0.7\nFIELDS {fields}\nSIZE{' 4' * len(names)}\n"
        f"TYPE{' F' * len(names)}\nCOUNT{' 1' * len(names)}\nWIDTH {count}\nHEIGHT 1\n"
        f"POINTS {count}\nDATA {form}\n"
    ).encode() + body


def test_clouds_of_pcl_are_read(tmp_path):
    path = tmp_path / "m.pcd"
    path.write_bytes(pcd("ascii", b"9 1 2 3\n9 4 5 6\n", "rgb x y z"))
    np.testing.assert_array_equal(read_arrays(path)[0], [[1, 2, 3], [4, 5, 6]])
    rows = np.array([[1, 2, 9, 3], [4, 5, 9, 6]], "<f4").tobytes()
    path.write_bytes(pcd("binary", rows, "x y rgb z"))
    vertices, faces = read_arrays(path)
    np.testing.assert_array_equal(vertices, [[1, 2, 3], [4, 5, 6]])
    assert len(faces) == 0


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"hello", "no line DATA"),
        (pcd("ascii", b"1 2\n3 4\n", "x y"), "no x, y and z, only x, y"),
        (pcd("binary_compressed", b""), "'binary_compressed'; save it as ascii"),
        (pcd("binary", bytes(12)), "announces 2 points, more than"),
        (pcd("ascii", b"1 2 3\n"), "announces 2 points, 1 were read"),
    ],
)
def test_clouds_that_cannot_be_used_are_refused(tmp_path, content, message):
    (tmp_path / "m.pcd").write_bytes(content)
    with pytest.raises(InputError, match=rf"m.pcd': .*{message}"):
        read_arrays(tmp_path / "m.pcd")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("hello\n", "does not begin with OFF"),
        ("OFF BINARY\n", "binary OFF"),
        ("OFF\n-3 1 0\n", "announces -3 vertices"),
        ("OFF\n3 1 0\n0 0 0\n1 0 0\n", "announces 3 vertices, 2 were read"),
        ("OFF\n1 1 0\n0 0 0\n", "announces 1 faces, 0 were read"),
        ("OFF\n1 1 0\n0 0 0\n-3 0 0 0\n", "negative number of corners"),
        ("OFF\n1 1 0\n0 0 0\n3 0 0\n", "fewer corners"),
    ],
)
def test_off_files_that_cannot_be_used_are_refused(tmp_path, text, message):
    (tmp_path / "m.off").write_text(text)
    with pytest.raises(InputError, match=rf"m.off': .*{message}"):
        read_arrays(tmp_path / "m.off")
