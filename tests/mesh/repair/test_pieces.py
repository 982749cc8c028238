import numpy as np

from damaged import joined
from esd.mesh.mesh import Mesh
from esd.mesh.repair.pieces import NEAR, is_ground, stand_ins
from esd.mesh.shapes import icosphere


def test_near_vertices_stand_in_and_far_ones_do_not():
    # the kept piece is a line with a diagonal of 10, so that up to 0.5 is near
    vertices = np.array([[0.0, 0, 0], [10, 0, 0], [0.1, 0.2, 0], [10, 10 * NEAR, 0], [5, 0, 0]])
    found = stand_ins(vertices, kept=np.array([0, 1]), dropped=np.array([2, 3, 4]))
    np.testing.assert_array_equal(found, [0, 1, -1])
    none = stand_ins(vertices, kept=np.array([0, 1]), dropped=np.zeros(0, dtype=np.int64))
    assert len(none) == 0


def plane(height: float) -> Mesh:
    """A square of 4 × 4 around the vertical axis."""
    x, y = np.meshgrid(np.linspace(-2, 2, 5), np.linspace(-2, 2, 5))
    corner = np.add.outer(5 * np.arange(4), np.arange(4)).ravel()
    faces = np.concatenate([corner[:, None] + [0, 1, 6], corner[:, None] + [0, 6, 5]])
    return Mesh(np.stack([x.ravel(), y.ravel(), np.full(25, height)], axis=1), faces)


def test_a_plane_that_all_else_lies_on_is_the_ground():
    ball = icosphere(2)
    both = Mesh(*joined(ball, plane(-1.0)))
    of_plane = np.arange(len(both.faces)) >= len(ball.faces)
    np.testing.assert_array_equal(is_ground(both), of_plane)
    assert not is_ground(Mesh(*joined(ball, plane(0.3)))).any()  # goes through it
    assert not is_ground(plane(0.0)).any()  # there is nothing else
    assert not is_ground(Mesh(*joined(plane(0.0), plane(1.0)))).any()  # sides of a box
    beside = plane(0.0)
    beside = Mesh(beside.vertices + np.array([9, 0, 0]), beside.faces)
    assert not is_ground(Mesh(*joined(plane(0.0), beside))).any()
