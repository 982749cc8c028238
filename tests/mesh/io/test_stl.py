import numpy as np
import pytest

from esd.common import InputError
from esd.mesh.io.meshes import read_arrays, read_mesh, write_mesh
from esd.mesh.io.stl import stl_bytes, stl_vertices
from esd.mesh.mesh import Mesh
from esd.mesh.shapes import torus

TEXT = b"""solid a
facet normal 0 0 1
 outer loop
  vertex 0 0 0
  vertex 1 0 0
  vertex 0 1e0 0
 endloop
endfacet
endsolid a
"""


def test_text_is_read(tmp_path):
    for content in (TEXT, b"\xef\xbb\xbf" + TEXT):  # the latter as editors of Windows save it
        (tmp_path / "m.stl").write_bytes(content)
        vertices, faces = read_arrays(tmp_path / "m.stl")
        np.testing.assert_array_equal(vertices, [[0, 0, 0], [1, 0, 0], [0, 1, 0]])
        np.testing.assert_array_equal(faces, [[0, 1, 2]])


def test_bytes_after_the_last_triangle_are_left_out(tmp_path):
    content = stl_bytes(torus(5, 4))
    (tmp_path / "m.stl").write_bytes(content + b"made by a scanner")
    assert len(read_mesh(tmp_path / "m.stl").faces) == 40


def test_binary_files_that_begin_with_solid_are_read(tmp_path):
    (tmp_path / "m.stl").write_bytes(b"solid" + stl_bytes(torus(5, 4))[5:])
    assert len(read_mesh(tmp_path / "m.stl").faces) == 40


def test_vertices_are_found_again(tmp_path):
    mesh = torus(5, 4)
    order = np.random.default_rng(0).permutation(20)
    mesh = Mesh(mesh.vertices[order], np.argsort(order)[mesh.faces])
    lone = Mesh(np.concatenate([mesh.vertices, [[9, 9, 9]]]), mesh.faces)
    write_mesh(lone, tmp_path / "m.stl")
    index = stl_vertices(lone)
    assert index[-1] == -1
    back = read_mesh(tmp_path / "m.stl").vertices
    np.testing.assert_array_equal(back[index[:-1]], mesh.vertices.astype("f4"))


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (stl_bytes(torus(5, 4))[:-20], "announces 40 triangles and holds 39; it is cut short"),
        (b"Dear reader, this is a letter and no mesh at all. " * 5, "no STL file"),
        (b"solid as a rock", "no STL file"),
        (TEXT[:80], "cut short"),
        (TEXT.replace(b"  vertex 1 0 0\n", b""), "1 triangles and 2 corners"),
        (bytes(84), "no triangles"),
    ],
)
def test_what_is_no_whole_file_is_refused(tmp_path, content, message):
    (tmp_path / "m.stl").write_bytes(content)
    with pytest.raises(InputError, match=rf"m.stl': .*{message}"):
        read_arrays(tmp_path / "m.stl")
