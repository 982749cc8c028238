import numpy as np
import pytest

from esd.common import InputError
from esd.mesh.io.meshes import read_arrays

SQUARE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [2, 0, 0]], dtype="<f4")
XYZ = "element vertex 5\nproperty float x\nproperty float y\nproperty float z\n"
LIST = "property list uchar int vertex_indices\n"
ROWS = "0 0 0\n1 0 0\n1 1 0\n0 1 0\n2 0 0\n"


def arrays(folder, head, body=b"", form="ascii"):
    path = folder / "m.ply"
    path.write_bytes(f"ply\nformat {form} 1.0\n{head}end_header\n".encode() + body)
    return read_arrays(path)


@pytest.mark.parametrize("order", ["<", ">"])
def test_binary_triangles_among_quadrilaterals(tmp_path, order):
    form = "binary_little_endian" if order == "<" else "binary_big_endian"
    lists = ([0, 1, 2, 3], [1, 4, 2])
    body = b"".join(bytes([len(f)]) + np.array(f, f"{order}i4").tobytes() for f in lists)
    vertices, faces = arrays(
        tmp_path,
        XYZ + "element face 2\n" + LIST,
        SQUARE.astype(f"{order}f4").tobytes() + body,
        form,
    )
    np.testing.assert_array_equal(vertices, SQUARE)
    np.testing.assert_array_equal(faces, [[0, 1, 2], [0, 2, 3], [1, 4, 2]])


def test_text_triangles_among_quadrilaterals_with_coordinates_at_corners(tmp_path):
    head = XYZ + "element face 2\n" + LIST + "property list uchar float texcoord\n"
    body = ROWS + "4 0 1 2 3 8 0 0 1 0 1 1 0 1\n3 1 4 2 6 0 0 1 0 1 1\n"
    _, faces = arrays(tmp_path, head, body.encode())
    np.testing.assert_array_equal(faces, [[0, 1, 2], [0, 2, 3], [1, 4, 2]])


def test_strips_turn_every_other_triangle(tmp_path):
    head = XYZ + "element tristrips 1\nproperty list int int vertex_indices\n"
    _, faces = arrays(tmp_path, head, (ROWS + "8 0 1 3 2 -1 1 4 2\n").encode())
    np.testing.assert_array_equal(faces, [[0, 1, 3], [3, 1, 2], [1, 4, 2]])


def test_points_are_those_of_files_that_declare_no_faces(tmp_path):
    for extra in ("", "element face 0\n" + LIST):
        vertices, faces = arrays(tmp_path, XYZ + extra, ROWS.encode())
        assert (len(vertices), len(faces)) == (5, 0)


@pytest.mark.parametrize(
    ("head", "body", "message"),
    [
        (
            XYZ + "element edge 1\nproperty int vertex1\nproperty int vertex2\n",
            "0 1",
            "edges and no",
        ),
        (XYZ + "element face 1\n" + LIST, "2 0 1", "none of its faces has three"),
        (XYZ + "element face 1\nproperty int a\n", "2", "'face' has no list `vertex_indices`"),
        (XYZ + "element face 1\n" + LIST, "3 0 1", "beyond the end"),
        (XYZ + "element face 9\n" + LIST, "3 0 1 2", "announces 9 of 'face'"),
        (XYZ + "element face 1\nproperty list half int a\n", "", "no type 'half'"),
        ("element vertex 1\nproperty float x\n", "0", "no x, y and z"),
        ("element vertex -1\nproperty float x\n", "0", "announces -1 of 'vertex'"),
    ],
)
def test_what_cannot_be_used_is_refused_by_name(tmp_path, head, body, message):
    with pytest.raises(InputError, match=rf"m.ply': .*{message}"):
        arrays(tmp_path, head, ((ROWS if head.startswith(XYZ) else "") + body).encode())


def test_binary_lists_that_are_cut_are_refused(tmp_path):
    body = SQUARE.tobytes() + b"\x03" + bytes(12) + b"\x04" + bytes(12)
    with pytest.raises(InputError, match="beyond the end"):
        arrays(tmp_path, XYZ + "element face 2\n" + LIST, body, "binary_little_endian")
    (tmp_path / "n.ply").write_bytes(b"plain text")
    with pytest.raises(InputError, match="does not begin with `ply`"):
        read_arrays(tmp_path / "n.ply")


def test_a_comment_may_name_the_end_of_the_head(tmp_path):
    head = "comment end_header follows\n" + XYZ + "element face 1\n" + LIST
    _, faces = arrays(tmp_path, head, (ROWS + "3 0 1 2\n").encode())
    np.testing.assert_array_equal(faces, [[0, 1, 2]])
