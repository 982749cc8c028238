import numpy as np
import pytest

from esd.common import InputError
from esd.evaluation.errors import true_map, vertex_errors
from esd.mesh.shapes import grid


def test_errors_along_a_straight_line_are_its_length():
    mesh = grid(5, 3, width=4.0, height=2.0)  # area 8; vertex 3 i + j at (i, j)
    errors = vertex_errors(mesh, np.array([0, 3, -1, 5]), np.array([0, 12, 1, -1]))
    np.testing.assert_allclose(errors, [0, 3 / np.sqrt(8), np.nan, np.nan])


def test_true_map_joins_points():
    truth = true_map(np.array([2, 0, -1]), np.array([5, 7, 8]), 4)
    np.testing.assert_array_equal(truth, [7, -1, 5, -1])
    with pytest.raises(InputError, match="one has 2, the other 1"):
        true_map(np.array([0, 1]), np.array([0]), 4)
    with pytest.raises(InputError, match=r"source vertex 4 \(from 0\); the mesh has 4"):
        true_map(np.array([4]), np.array([0]), 4)
