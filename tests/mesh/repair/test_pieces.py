import numpy as np

from esd.mesh.repair.pieces import NEAR, stand_ins


def test_near_vertices_stand_in_and_far_ones_do_not():
    # the kept piece is a line with a diagonal of 10, so that up to 0.5 is near
    vertices = np.array([[0.0, 0, 0], [10, 0, 0], [0.1, 0.2, 0], [10, 10 * NEAR, 0], [5, 0, 0]])
    found = stand_ins(vertices, kept=np.array([0, 1]), dropped=np.array([2, 3, 4]))
    np.testing.assert_array_equal(found, [0, 1, -1])
    none = stand_ins(vertices, kept=np.array([0, 1]), dropped=np.zeros(0, dtype=np.int64))
    assert len(none) == 0
