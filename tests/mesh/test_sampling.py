import numpy as np
import pytest

from esd.common import InputError
from esd.mesh.geodesics import geodesic_graph
from esd.mesh.mesh import Mesh
from esd.mesh.sampling import sample_farthest, spread
from esd.mesh.shapes import grid, icosphere


def test_farthest_samples_spread_and_are_distinct(sphere):
    sample = sample_farthest(sphere, 12, seed=1, graph=geodesic_graph(sphere))
    corners = sphere.vertices[sample]
    angles = np.arccos(np.clip(corners @ corners.T, -1, 1))[np.triu_indices(12, 1)]
    assert angles.min() > 0.6  # an icosahedron's corners are 1.1 apart, greedy choice nearly half
    np.testing.assert_array_equal(sample, sample_farthest(sphere, 12, seed=1))


def test_farthest_samples_reach_all_components_and_no_vertex_without_a_face():
    ball = icosphere(0)
    vertices = np.concatenate([[[99, 0, 0]], ball.vertices, ball.vertices + 5])
    two = Mesh(vertices, np.concatenate([ball.faces + 1, ball.faces + 13]))
    sample = sample_farthest(two, 2)
    assert (sample > 12).sum() == 1
    assert 0 not in sample_farthest(two, 24)
    with pytest.raises(InputError, match="`count` must be from 1 to 24 for this mesh; got 25"):
        sample_farthest(two, 25)


def test_points_spread_from_the_first_to_the_farthest():
    points = grid(3, 3).vertices
    np.testing.assert_array_equal(spread(points, 2), [0, 8])
    assert set(spread(points, 4)) == {0, 2, 6, 8}
    assert sorted(spread(points, 99)) == list(range(9))
