import numpy as np

from esd.mesh.geometry import edge_lengths, face_areas
from esd.mesh.mesh import Mesh
from esd.mesh.remesh.refinement import refined
from esd.mesh.remesh.relaxing import Motion, is_poor, normals_at, relaxed
from esd.mesh.shapes import grid
from esd.mesh.surface import at_vertices, positions
from esd.mesh.topology import boundary_edges


def test_relaxing_evens_out_a_plane_and_leaves_its_border():
    flat = grid(9, 9)
    inner = np.setdiff1d(np.arange(81), boundary_edges(flat))
    moved = flat.vertices.copy()
    moved[inner, :2] += np.random.default_rng(0).uniform(-0.05, 0.05, (len(inner), 2))
    mesh = Mesh(moved, flat.faces)
    fine = refined(mesh, 9.0)
    motion = Motion.on(fine, np.ones(81), 81)
    points, faces = at_vertices(fine.mesh, np.arange(81)), mesh.faces
    before = face_areas(mesh).std()
    for _ in range(5):
        points, faces = relaxed(motion, points, faces, excess=0.0, everywhere=True)
    new = Mesh(positions(fine.mesh, points), faces)
    rim = np.unique(boundary_edges(flat))
    np.testing.assert_allclose(new.vertices[rim], mesh.vertices[rim])
    np.testing.assert_allclose(new.vertices[:, 2], 0, atol=1e-12)
    assert face_areas(new).std() < before / 2
    assert edge_lengths(new).max() < edge_lengths(mesh).max()
    np.testing.assert_allclose(normals_at(fine, points), np.tile([0, 0, 1], (81, 1)))


def test_slivers_and_inverted_triangles_are_poor():
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0.5, 0.001, 0]])
    faces = np.array([[0, 1, 2], [0, 1, 3], [0, 2, 1]])
    up = np.tile([0.0, 0, 1], (4, 1))
    assert is_poor(vertices, faces, up).tolist() == [False, True, True]
