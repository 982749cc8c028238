import numpy as np
import pytest

from esd.mesh import geometry as m
from esd.mesh.mesh import Mesh
from esd.mesh.shapes import grid, icosphere, torus
from esd.mesh.topology import boundary_edges
from measures import signed_volume

TRIANGLE = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])


def test_measures_of_known_shapes():
    flat = grid(4, 6, width=2, height=3)
    assert m.surface_area(flat) == pytest.approx(6)
    assert m.vertex_areas(flat).sum() == pytest.approx(6)
    np.testing.assert_allclose(m.vertex_normals(flat), np.tile([0, 0, 1.0], (24, 1)))
    assert len(boundary_edges(flat)) == 2 * (3 + 5)
    assert len(m.edges(icosphere(1))) == 3 * len(icosphere(1).vertices) - 6  # Euler
    assert m.is_consistently_oriented(torus(9, 7))
    assert not m.is_consistently_oriented(Mesh(TRIANGLE[[0, 1, 2, 2]], [[0, 1, 2], [0, 1, 3]]))


def test_volume_and_area_of_the_sphere_converge_at_order_two():
    errors = [
        (4 / 3 * np.pi - signed_volume(icosphere(s)), 4 * np.pi - m.surface_area(icosphere(s)))
        for s in (3, 4)
    ]
    order = np.log2(np.divide(*errors))
    assert (order > 1.9).all()


def test_components_come_largest_first_and_lone_vertices_have_none():
    big, small = icosphere(1), icosphere(0)
    count = len(small.vertices)
    mesh = Mesh(
        np.concatenate([small.vertices, big.vertices, [[9, 9, 9]]]),
        np.concatenate([small.faces, big.faces + count]),
    )
    label = m.components(mesh)
    np.testing.assert_array_equal(np.unique(label), [-1, 0, 1])
    assert (label[:count] == 1).all()
    assert label[-1] == -1
