import sys

import numpy as np
import pytest

from esd.common import InputError
from esd.mesh.geodesics import geodesic_diameter, geodesic_distances, geodesic_graph
from esd.mesh.mesh import Mesh
from esd.mesh.shapes import grid, icosphere


def test_distances_on_the_sphere_are_angles():
    mesh = icosphere(4)
    distance = geodesic_distances(mesh, np.array([0]))[0]
    angle = np.arccos(np.clip(mesh.vertices @ mesh.vertices[0], -1, 1))
    far = angle > 0.2
    ratio = distance[far] / angle[far]
    assert ratio.min() > 0.99  # chords are a little shorter than arcs
    assert ratio.mean() < 1.03  # about 1 % too long on average; edges alone give 5 %


def test_exact_distances_on_a_plane_are_euclidean_and_never_longer():
    pytest.importorskip("pygeodesic", reason="exact geodesics need the extra `exact`")
    mesh = grid(9, 7)
    exact = geodesic_distances(mesh, np.array([5]), exact=True)[0]
    np.testing.assert_allclose(
        exact, np.linalg.norm(mesh.vertices - mesh.vertices[5], axis=1), atol=1e-9
    )
    assert (geodesic_distances(mesh, np.array([5]))[0] >= exact - 1e-9).all()


def test_distances_are_symmetric_and_scale_with_the_shape(blob):
    some = np.array([0, 50, 200])
    distance = geodesic_distances(blob, some)[:, some]
    np.testing.assert_allclose(distance, distance.T, rtol=1e-12)
    scaled = geodesic_distances(Mesh(3 * blob.vertices, blob.faces), some)[:, some]
    np.testing.assert_allclose(scaled, 3 * distance, rtol=1e-12)


def test_other_components_are_infinitely_far():
    mesh = icosphere(1)
    count = len(mesh.vertices)
    two = Mesh(
        np.concatenate([mesh.vertices, 0.5 * mesh.vertices]),
        np.concatenate([mesh.faces, mesh.faces + count]),
    )
    distance = geodesic_distances(two, np.array([0]))[0]
    assert np.isfinite(distance[:count]).all()
    assert np.isinf(distance[count:]).all()
    assert geodesic_diameter(two) == pytest.approx(np.pi, rel=0.1)


def test_diameter_of_a_square_is_its_diagonal():
    assert geodesic_diameter(grid(20, 20)) == pytest.approx(2**0.5, rel=0.01)


def test_without_the_extra_the_message_names_it(monkeypatch, sphere):
    monkeypatch.setitem(sys.modules, "pygeodesic", None)
    with pytest.raises(
        InputError, match=r"Exact geodesics need pygeodesic: pip install .*\[exact\]"
    ):
        geodesic_distances(sphere, np.array([0]), exact=True)


def test_distances_are_on_whatever_is_a_mesh(sphere):
    found = geodesic_distances((sphere.vertices, sphere.faces), [3])
    np.testing.assert_array_equal(found, geodesic_distances(sphere, np.array([3])))


def test_sources_must_be_vertices(sphere):
    with pytest.raises(InputError, match="`sources` must be from 0 to"):
        geodesic_distances(sphere, np.array([len(sphere.vertices)]))


def test_distance_from_the_nearest_of_several_sources(blob):
    graph = geodesic_graph(blob)
    sources = np.array([3, 100, 400])
    nearest = graph.distances(sources).min(axis=0)
    np.testing.assert_array_equal(graph.distances_to_any(sources), nearest)
    within = np.isfinite(graph.distances_to_any(sources, limit=0.3))
    np.testing.assert_array_equal(within, nearest <= 0.3)
    assert np.isinf(graph.distances_to_any(np.array([], dtype=np.int64))).all()


def test_nearest_source_is_that_of_the_smallest_distance():
    graph = geodesic_graph(icosphere(2))
    sources = np.array([3, 50, 120])
    np.testing.assert_array_equal(
        graph.nearest_source(sources), sources[graph.distances(sources).argmin(axis=0)]
    )


def test_no_source_is_nearest_where_none_is_reached():
    one = icosphere(0)
    two = Mesh(
        np.concatenate([one.vertices, one.vertices + 5]),
        np.concatenate([one.faces, one.faces + 12]),
    )
    nearest = geodesic_graph(two).nearest_source(np.array([0]))
    np.testing.assert_array_equal(nearest, np.repeat([0, -1], 12))
