import gzip
import zipfile

import numpy as np
import pytest

from esd.common import InputError
from esd.mesh.geometry import surface_area
from esd.mesh.io.meshes import read_arrays, read_mesh, write_mesh
from esd.mesh.mesh import Mesh
from esd.mesh.shapes import torus


@pytest.mark.parametrize("suffix", ["off", "obj", "ply", "glb"])
def test_vertices_and_faces_come_back_in_order(tmp_path, suffix):
    mesh = torus(7, 5)
    lone = Mesh(np.concatenate([mesh.vertices, [[3, 3, 3]]]), mesh.faces)  # no face: kept too
    write_mesh(lone, tmp_path / f"m.{suffix}")
    back = read_mesh(tmp_path / f"m.{suffix}")
    np.testing.assert_array_equal(back.faces, lone.faces)
    if suffix == "glb":  # which holds 32 bits
        np.testing.assert_allclose(back.vertices, lone.vertices, atol=1e-7)
    else:
        np.testing.assert_array_equal(back.vertices, lone.vertices)


def test_stl_corners_at_one_place_become_one_vertex(tmp_path):
    mesh = torus(7, 5)
    write_mesh(mesh, tmp_path / "m.stl")
    back = read_mesh(tmp_path / "m.stl")
    assert len(back.vertices) == len(mesh.vertices)
    assert surface_area(back) == pytest.approx(surface_area(mesh), rel=1e-6)


OBJ = """o seam
v 0 0 0
v 1 0 0
v 1 1 0
v 0 1 0
v 5 5 5
vt 0 0
vt 1 1
f 1/1 2/2 3/1 4/2
usemtl other
f -5/2 -3/1 -4/1
"""
OFF = "OFF\n# with a comment\n5 2 0\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n0 1 2\n4 0 1 2 3\n3 0 1 4\n"


@pytest.mark.parametrize(
    ("head", "faces"),
    [
        ("OFF\n4 2 0\n", ["3 0 1 2", "3 0 2 3"]),
        ("OFF\n4 2 0\n", ["3 0 1 2 255 0 0", "3 0 2 3 0 255 0"]),  # with colours
        ("OFF\n# a square\n4 2 0\n", ["3 0 1 2 # first", "3 0 2 3"]),
        ("OFF 4 2 0\n", ["3 0 1 2", "3 0 2 3"]),
    ],
)
def test_all_that_off_may_hold_is_read_alike(tmp_path, head, faces):
    square = "0 0 0\n1 0 0\n1 1 0\n0 1 1e-1\n"
    path = tmp_path / "square.off"
    path.write_text(head + square + "\n".join(faces) + "\n")
    vertices, triangles = read_arrays(path)
    np.testing.assert_array_equal(vertices, [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0.1]])
    np.testing.assert_array_equal(triangles, [[0, 1, 2], [0, 2, 3]])


@pytest.mark.parametrize(("name", "text"), [("m.obj", OBJ), ("m.off", OFF)])
def test_polygons_are_cut_and_reported_and_seams_do_not_split(tmp_path, caplog, name, text):
    (tmp_path / name).write_text(text)
    mesh = read_mesh(tmp_path / name)
    assert mesh.vertices.shape == (5, 3)
    assert len(mesh.faces) == 3
    assert "2 polygons were cut into 3 triangles" in caplog.text


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("short.off", b"OFF\n1000000000 5 0\n1 1 1\n"),
        ("garbage.off", b"hello"),
        ("garbage.glb", b"hello"),
        ("garbage.obj", b"\x00\x01"),
        ("zero.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 0 1 2\n"),
        ("beyond.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 4\n"),
        (
            "short.ply",
            b"ply\nformat binary_little_endian 1.0\nelement vertex 1000000000\n"
            b"property float x\nproperty float y\nproperty float z\nelement face 1\n"
            b"property list uchar int vertex_indices\nend_header\n",
        ),
        ("short.stl", bytes(80) + (10**9).to_bytes(4, "little") + b"xx"),
    ],
)
def test_damaged_files_are_refused_by_name(tmp_path, name, content):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=name):
        read_mesh(tmp_path / name)


def test_wrong_paths_are_refused(tmp_path):
    with pytest.raises(InputError, match="There is no file"):
        read_mesh(tmp_path / "no.off")
    with pytest.raises(InputError, match="not a mesh file"):
        read_mesh(tmp_path / "m.abc")
    with pytest.raises(InputError, match="expected a suffix"):
        write_mesh(torus(4, 4), tmp_path / "m.abc")
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="cannot be written"):
        write_mesh(torus(4, 4), tmp_path / "file" / "m.off")


def test_obj_vertices_without_three_coordinates_are_refused(tmp_path):
    path = tmp_path / "cut.obj"
    path.write_text("v 0 0\n")
    with pytest.raises(InputError, match="fewer than three coordinates"):
        read_mesh(path)


def test_packed_files_are_read(tmp_path):
    mesh = torus(7, 5)
    write_mesh(mesh, tmp_path / "m.ply")
    (tmp_path / "m.ply.gz").write_bytes(gzip.compress((tmp_path / "m.ply").read_bytes()))
    back = read_mesh(tmp_path / "m.ply.gz")
    np.testing.assert_array_equal(back.vertices, mesh.vertices)
    np.testing.assert_array_equal(back.faces, mesh.faces)
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
