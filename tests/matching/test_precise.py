import numpy as np
import pytest

from esd.common import InputError
from esd.matching.precise import precise_map
from esd.mesh.shapes import grid, icosphere
from esd.mesh.surface import interpolated


def test_points_of_a_plane_are_found_exactly():
    mesh = grid(9, 9)
    points = np.random.default_rng(0).uniform(0, 1, (200, 2))
    flat = mesh.vertices[:, :2]
    nearest = ((points[:, None] - flat) ** 2).sum(axis=2).argmin(axis=1)
    found = precise_map(points, flat, mesh.faces, nearest)
    np.testing.assert_allclose(found.weights.sum(axis=1), 1)
    assert found.weights.min() >= 0
    inside = np.linalg.norm(interpolated(flat, mesh, found) - points, axis=1) < 1e-12
    # a face that holds the point need not touch the nearest vertex, but nearly always does
    assert inside.mean() > 0.9
    outside = precise_map(np.array([[-1.0, 0.5]]), flat, mesh.faces, np.array([4]))
    np.testing.assert_allclose(interpolated(flat, mesh, outside), [[0, 0.5]], atol=1e-12)


def test_precise_points_are_nearer_than_vertices_and_no_sample_of_a_face_is_nearer():
    mesh = icosphere(2)
    points = 1.1 * icosphere(3).vertices[:100]
    nearest = ((points[:, None] - mesh.vertices) ** 2).sum(axis=2).argmin(axis=1)
    nearest[5] = -1
    found = precise_map(points, mesh.vertices, mesh.faces, nearest)
    gap = np.linalg.norm(interpolated(mesh.vertices, mesh, found) - points, axis=1)
    assert np.isnan(gap[5])
    assert found.face[5] == -1
    known = np.arange(100) != 5
    assert (gap <= np.linalg.norm(mesh.vertices[nearest] - points, axis=1) + 1e-12)[known].all()
    weights = np.random.default_rng(0).dirichlet(np.ones(3), 300)
    for i in np.flatnonzero(known)[:20]:
        faces = mesh.faces[(mesh.faces == nearest[i]).any(axis=1)]
        samples = np.einsum("sc,fcd->fsd", weights, mesh.vertices[faces]).reshape(-1, 3)
        assert gap[i] <= np.linalg.norm(samples - points[i], axis=1).min() + 1e-12


def test_matched_vertices_without_a_face_are_refused():
    with pytest.raises(InputError, match="Target vertex 3 is matched and has no face"):
        precise_map(np.zeros((1, 3)), np.eye(4, 3), np.array([[0, 1, 2]]), np.array([3]))
