import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from esd.mesh.io.meshes import read_arrays
from esd.mesh.io.polygons import triangulated

L = np.array([[0, 0, 0], [1, 0, 0], [1, 2, 0], [3, 2, 0], [3, 3, 0], [0, 3, 0]], dtype=float)


def vector_areas(vertices, faces):
    first, second, third = (vertices[faces[:, k]] for k in range(3))
    return np.cross(second - first, third - first) / 2


@pytest.mark.parametrize("start", range(6))
@given(seed=st.integers(0, 1000))
def test_a_concave_polygon_is_covered_once_in_its_orientation(start, seed):
    turn = Rotation.random(random_state=seed)
    vertices = turn.apply(np.roll(L, -start, axis=0))
    faces = triangulated(vertices, np.arange(6), np.array([6])).corners
    areas = vector_areas(vertices, faces)
    assert len(faces) == 4
    # area 1·2 + 3·1; rounding alone
    assert np.linalg.norm(areas, axis=1).sum() == pytest.approx(5, rel=1e-12)
    np.testing.assert_allclose(areas.sum(axis=0), turn.apply([0, 0, 5]), atol=1e-12)


def test_convex_polygons_are_cut_from_their_first_corner():
    square = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=float)
    corners = np.array([2, 3, 0, 1, 0, 1, 0, 1, 2])
    result = triangulated(square, corners, np.array([4, 2, 3]))
    np.testing.assert_array_equal(corners[result.corners], [[2, 3, 0], [2, 0, 1], [0, 1, 2]])
    np.testing.assert_array_equal(result.polygon, [0, 0, 2])


def test_corners_that_do_not_exist_are_kept():
    result = triangulated(np.zeros((2, 3)), np.array([0, 1, 7, 1]), np.array([4]))
    np.testing.assert_array_equal(result.corners, [[0, 1, 2], [0, 2, 3]])


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("m.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\nf 1 2\n"),
        ("m.off", "OFF\n3 2 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n2 0 1\n"),
        (
            "m.ply",
            "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\n"
            "property float z\nelement face 2\nproperty list uchar int vertex_indices\n"
            "end_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n2 0 1\n",
        ),
    ],
)
def test_faces_of_fewer_than_three_corners_are_reported(tmp_path, caplog, name, content):
    (tmp_path / name).write_text(content)
    assert len(read_arrays(tmp_path / name)[1]) == 1
    [said] = caplog.messages
    assert f"{name}': 1 face has fewer than three corners; is" in said
    (tmp_path / name).write_text(content.replace("2 0 1", "1 0").replace("f 1 2\n", "f 1\n"))
    caplog.clear()
    read_arrays(tmp_path / name)
    assert "fewer than three corners" in caplog.text
    assert "cut into" not in caplog.text
