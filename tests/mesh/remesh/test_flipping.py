import numpy as np
from scipy.spatial import Delaunay

from esd.mesh.remesh.flipping import flipped, is_inverted
from esd.mesh.topology import edge_table

UP = np.array([0.0, 0.0, 1.0])


def test_flips_lead_to_the_delaunay_triangles_of_a_plane():
    random = np.random.default_rng(0)
    x, y = np.meshgrid(np.arange(7.0), np.arange(7.0), indexing="ij")
    points = np.stack([x, y], axis=2).reshape(-1, 2) + random.uniform(-0.3, 0.3, (49, 2))
    delaunay = Delaunay(points).simplices
    a, b, c = points[delaunay].transpose(1, 0, 2)
    side, other = b - a, c - a
    clockwise = side[:, 0] * other[:, 1] < side[:, 1] * other[:, 0]
    delaunay[clockwise] = delaunay[clockwise][:, ::-1]
    vertices = np.column_stack([points, np.zeros(49)])
    normals = np.tile(UP, (49, 1))
    same = flipped(vertices, delaunay, normals, excess=0)
    np.testing.assert_array_equal(same, delaunay)
    # other triangles of the same points: the diagonals of some convex quadrilaterals changed
    others = flipped(vertices * [1, 0.4, 1], delaunay, normals, excess=0)
    assert len(edges_of(others) - edges_of(delaunay)) > 10
    again = flipped(vertices, others, normals, excess=0, rounds=50)
    assert edges_of(again) == edges_of(delaunay)


def edges_of(faces) -> set[tuple[int, ...]]:
    return {tuple(edge) for edge in edge_table(np.asarray(faces), 49).ends.tolist()}


def test_sharp_edges_stay():
    # two triangles of a ridge, whose shared edge is too long to be Delaunay
    vertices = np.array([[-3.0, 0, 0], [3, 0, 0], [0, 0.1, -1], [0, -0.1, -1]])
    faces = np.array([[0, 1, 2], [1, 0, 3]])
    normals = np.tile(UP, (4, 1))
    np.testing.assert_array_equal(flipped(vertices, faces, normals, excess=0), faces)
    flat = vertices * [1, 1, 0]
    changed = flipped(flat, faces, normals, excess=0)
    assert (2, 3) in edges_of(changed)
    assert (0, 1) not in edges_of(changed)


def test_inverted_triangles_face_against_all_of_their_normals():
    vertices, faces = np.eye(3), np.array([[0, 1, 2], [2, 1, 0], [0, 0, 1]])
    normals = np.ones((3, 3))
    assert is_inverted(vertices, faces, normals).tolist() == [False, True, True]
    normals[0] *= -1
    assert not is_inverted(vertices, faces[:2], normals).any()
