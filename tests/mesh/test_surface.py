import numpy as np
import pytest

from esd.mesh.geometry import vertex_normals
from esd.mesh.mesh import Mesh
from esd.mesh.shapes import grid, icosphere, torus
from esd.mesh.surface import (
    SurfacePoints,
    at_vertices,
    barycentric_weights,
    closest_in_triangles,
    closest_points,
    interpolated,
    nearest_vertices,
    positions,
)


def random_points(mesh, count=200):
    random = np.random.default_rng(0)
    face = random.integers(len(mesh.faces), size=count)
    return SurfacePoints(face, random.dirichlet([1, 1, 1], size=count))


def test_interpolation_reproduces_linear_functions():
    mesh = torus(12, 7)
    points = random_points(mesh)
    along = np.array([1.0, -2.0, 3.0])
    at = positions(mesh, points)
    np.testing.assert_allclose(interpolated(mesh.vertices @ along, mesh, points), at @ along)
    both = np.stack([mesh.vertices, 2 * mesh.vertices], axis=1)  # (n, 2, 3)
    np.testing.assert_allclose(interpolated(both, mesh, points), np.stack([at, 2 * at], axis=1))


def test_points_at_vertices_are_these_and_none_where_there_is_no_face():
    ball = icosphere(1)
    mesh = Mesh(np.vstack([[[9, 9, 9]], ball.vertices]), ball.faces + 1)
    asked = np.array([5, 0, -1, 42])
    points = at_vertices(mesh, asked)
    np.testing.assert_array_equal(points.face < 0, [False, True, True, False])
    np.testing.assert_array_equal(nearest_vertices(mesh, points), [5, -1, -1, 42])
    np.testing.assert_array_equal(positions(mesh, points)[[0, 3]], mesh.vertices[[5, 42]])
    for values in (mesh.vertices, mesh.vertices[:, 0]):
        assert np.isnan(interpolated(values, mesh, points)[1:3]).all()


def test_values_that_are_not_finite_count_at_corners_with_a_weight():
    mesh = grid(2, 2)
    points = SurfacePoints(np.array([0, 0]), np.array([[1.0, 0, 0], [0.5, 0.5, 0]]))
    values = np.zeros(4)
    values[mesh.faces[0]] = [7, 8, np.inf]
    np.testing.assert_array_equal(interpolated(values, mesh, points), [7, 7.5])
    values[mesh.faces[0, 1]] = np.nan
    both = np.stack([values, values], axis=1)
    np.testing.assert_array_equal(interpolated(both, mesh, points), [[7, 7], [np.nan, np.nan]])


def test_the_nearest_vertex_is_the_corner_of_most_weight():
    mesh = grid(3, 3)
    points = SurfacePoints(np.array([4, 4]), np.array([[0.2, 0.5, 0.3], [0.1, 0.1, 0.8]]))
    np.testing.assert_array_equal(nearest_vertices(mesh, points), mesh.faces[4, [1, 2]])


def test_where_takes_one_point_or_the_other():
    first, second = (random_points(grid(5, 5), count) for count in (4, 4))
    second = SurfacePoints(second.face + 1, 1 - second.weights)
    chosen = np.array([True, False, False, True])
    mixed = first.where(chosen, second)
    np.testing.assert_array_equal(mixed.face[chosen], first.face[chosen])
    np.testing.assert_array_equal(mixed.weights[~chosen], second.weights[~chosen])


def test_points_on_a_mesh_are_their_own_closest_points():
    mesh = icosphere(3)
    points = random_points(mesh)
    at = positions(mesh, points)
    found = closest_points(mesh, at, nearest_vertices(mesh, points))
    np.testing.assert_allclose(positions(mesh, found), at, atol=1e-12)
    assert found.weights.min() >= 0
    np.testing.assert_allclose(found.weights.sum(axis=1), 1)


def test_the_closest_point_is_found_from_a_vertex_that_is_not_the_nearest():
    mesh = icosphere(3)
    points = random_points(mesh)
    normals = vertex_normals(mesh)[nearest_vertices(mesh, points)]
    queries = positions(mesh, points) + 0.01 * normals
    # a corner of the face across the side opposite to the nearest vertex
    start = mesh.faces[points.face, points.weights.argmin(axis=1)]
    gap = np.linalg.norm(positions(mesh, closest_points(mesh, queries, start)) - queries, axis=1)
    every = mesh.vertices[mesh.faces]
    for query, found in zip(queries[:20], gap[:20], strict=True):
        _, squared = closest_in_triangles(np.tile(query, (len(every), 1)), every)
        assert found == pytest.approx(np.sqrt(squared.min()), rel=1e-9)


def test_barycentric_weights_of_known_points():
    triangle = np.array([[[0, 0, 0], [2, 0, 0], [0, 2, 0]]], dtype=float)
    queries = np.array([[0, 0, 1], [1, 1, 0], [0.5, 0.5, -3]], dtype=float)
    found = barycentric_weights(queries, np.repeat(triangle, 3, axis=0))
    np.testing.assert_allclose(found, [[1, 0, 0], [0, 0.5, 0.5], [0.5, 0.25, 0.25]])
    assert np.isnan(barycentric_weights(queries[:1], triangle * [1, 0, 1])).all()


@pytest.mark.parametrize("dimension", [2, 3, 7])
def test_the_closest_point_of_a_triangle_beats_every_sampled_point(dimension):
    random = np.random.default_rng(0)
    triangles = random.normal(size=(200, 3, dimension))
    points = random.normal(size=(200, dimension))
    found, squared = closest_in_triangles(points, triangles)
    assert found.min() > -1e-12  # of foot points inside, up to rounding
    np.testing.assert_allclose(found.sum(axis=1), 1)
    gap = np.linalg.norm(np.einsum("ni,nik->nk", found, triangles) - points, axis=1)
    # the squared distance may be a difference of numbers near one
    np.testing.assert_allclose(gap, np.sqrt(squared), atol=1e-6)
    for weights in random.dirichlet([1, 1, 1], size=300):
        sampled = np.einsum("i,nik->nk", weights, triangles)
        assert (gap <= np.linalg.norm(sampled - points, axis=1) + 1e-12).all()


@pytest.mark.parametrize("dimension", [2, 3])
def test_the_closest_point_of_a_triangle_without_area_lies_on_its_longest_side(dimension):
    triangle = np.array([[[0, 0, 0], [1, 0, 0], [2, 0, 0]]], dtype=float)[:, :, :dimension]
    found, squared = closest_in_triangles(np.array([[1.5, 1.0, 0]])[:, :dimension], triangle)
    expected = np.array([[1.5, 0, 0]])[:, :dimension]
    assert np.einsum("ni,nik->nk", found, triangle) == pytest.approx(expected)
    assert squared == pytest.approx(1)
