import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

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
