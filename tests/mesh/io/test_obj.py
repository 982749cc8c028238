import numpy as np
import pytest

from esd.common import InputError
from esd.mesh.io.meshes import read_arrays
from esd.mesh.io.obj import read_obj

TRIANGLE = "v 0 0 0\nv 1 0 0\nv 0 1 0\n"


def test_negative_indices_count_back_from_what_was_read_so_far(tmp_path):
    path = tmp_path / "m.obj"
    path.write_text(
        TRIANGLE + "vt 0 0\nvt 1 0\nvt 0 1\nf -3/-3 -2/-2 -1/-1\n"
        "v 0 0 1\nv 1 0 1\nv 0 1 1\nvt .5 0\nvt .5 1\nvt 1 1\nf -3/-3 -2/-2 -1/-1\n"
    )
    content = read_obj(path)
    np.testing.assert_array_equal(content.faces, [[0, 1, 2], [3, 4, 5]])
    np.testing.assert_array_equal(content.texture_faces, [[0, 1, 2], [3, 4, 5]])


@pytest.mark.parametrize(
    "text",
    [
        "\ufeff" + TRIANGLE + "f 1 2 3\n",
        "  v 0 0 0\n\tv 1 0 0\n  v 0 1 0\n   f 1 2 3\n",
        TRIANGLE + "l 1 2\nf 1//1 2//1 3//1\n",
        TRIANGLE + "f 1 2 \\\n3\n",
        TRIANGLE.replace("\n", "\r\n") + "f 1 2 \\\r\n3\r\n",
    ],
)
def test_all_that_obj_may_hold_is_read_alike(tmp_path, text):
    (tmp_path / "m.obj").write_bytes(text.encode())
    vertices, faces = read_arrays(tmp_path / "m.obj")
    np.testing.assert_array_equal(vertices, [[0, 0, 0], [1, 0, 0], [0, 1, 0]])
    np.testing.assert_array_equal(faces, [[0, 1, 2]])


def test_corners_that_are_written_alike_and_otherwise_are_read_alike(tmp_path):
    places = "vt 0 0\nvt 1 0\nvt 0 1\n"
    found = []
    for face in ("f 1/2/1 2/3/1 3/1/1\n", "f 1/2 2/3/1 3/1\n", "f 1/2 2/3 3/1\n"):
        (tmp_path / "m.obj").write_text(TRIANGLE + places + face)
        content = read_obj(tmp_path / "m.obj")
        found.append((content.faces.tolist(), content.texture_faces.tolist()))
    assert found == [([[0, 1, 2]], [[1, 2, 0]])] * 3
    (tmp_path / "m.obj").write_text(TRIANGLE + places + "f 1/ 2/ 3/\n")
    assert read_obj(tmp_path / "m.obj").texture_faces.tolist() == [[-1, -1, -1]]
    (tmp_path / "m.obj").write_text(TRIANGLE + places + "f /1 /2 /3\n")
    with pytest.raises(InputError, match="cannot be read as OBJ"):
        read_arrays(tmp_path / "m.obj")


def test_materials_are_those_of_the_faces(tmp_path):
    path = tmp_path / "m.obj"
    path.write_text(
        TRIANGLE + "f 1 2 3\nusemtl a b\nf 1 2 3\nusemtl c\nf 1 2 3 1\nusemtl a b\nf 3 2 1\n"
    )
    content = read_obj(path)
    assert content.materials == ("a b", "c")
    np.testing.assert_array_equal(content.material, [-1, 0, 1, 1, 0])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (TRIANGLE + "l 1 2 3\n", "no faces in it that could be read"),
        (TRIANGLE + "f 1 2 -4\n", "before the first vertex"),
        (TRIANGLE + "f 0 1 2\n", "count their vertices from 1"),
        ("f 1 2 3\n", "no vertices"),
    ],
)
def test_what_cannot_be_used_is_refused_by_name(tmp_path, text, message):
    (tmp_path / "m.obj").write_text(text)
    with pytest.raises(InputError, match=rf"m.obj': .*{message}"):
        read_arrays(tmp_path / "m.obj")
