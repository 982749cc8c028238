import numpy as np
import pytest

from esd.common import InputError
from esd.evaluation.errors import (
    Truth,
    area_under_curve,
    cumulative_curve,
    errors_on_target,
    geodesic_errors,
    true_map,
    vertex_errors,
)
from esd.evaluation.protocol import (
    NEAR,
)
from esd.mesh.geodesics import geodesic_graph
from esd.mesh.mesh import Mesh
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


def test_errors_are_distances_from_either_side(blob):
    graph = geodesic_graph(blob)
    generator = np.random.default_rng(0)
    count = len(blob.vertices)
    many, few = generator.integers(count, size=600), generator.integers(5, size=600)
    expected = graph.distances(np.arange(count))
    for predicted, truth in [(many, few), (few, many)]:
        other = (truth + 1) % count
        errors = geodesic_errors(graph, predicted, (truth, other))
        np.testing.assert_allclose(errors[0], expected[predicted, truth])
        np.testing.assert_allclose(errors[1], expected[predicted, other])
        [limited] = geodesic_errors(graph, predicted, (truth,), limit=0.5)
        np.testing.assert_array_equal(limited <= 0.5, errors[0] <= 0.5)


def test_points_without_match_or_truth_have_no_error(blob):
    [errors] = geodesic_errors(geodesic_graph(blob), np.array([0, -1, 3]), (np.array([0, 1, -1]),))
    np.testing.assert_array_equal(errors, [0, np.nan, np.nan])


def test_curve_and_area_of_known_errors():
    errors = np.array([0.0, 0.1, 0.2, np.nan])
    np.testing.assert_array_equal(
        cumulative_curve(errors, np.array([0, 0.1, 0.15, 1])), [0.25, 0.5, 0.5, 0.75]
    )
    assert area_under_curve(errors, largest=0.2) == pytest.approx((1 + 0.5 + 0) / 4)
    radii = np.linspace(0, 0.25, 20001)
    assert area_under_curve(errors) == pytest.approx(
        cumulative_curve(errors, radii).mean(), abs=1e-3
    )


def test_errors_on_a_target_are_those_of_each_map(blob):
    count = len(blob.vertices)
    index, mirrored = np.arange(count), np.arange(count)[::-1].copy()
    predicted = np.stack([index, np.roll(index, 5)])
    found = errors_on_target(Truth(blob, index, mirrored), predicted)
    distances = geodesic_graph(blob).distances(index)
    np.testing.assert_allclose(found.direct, distances[predicted, index])
    np.testing.assert_allclose(
        found.nearer, np.minimum(found.direct, distances[predicted, mirrored])
    )
    limited = errors_on_target(Truth(blob, index), predicted, limit=NEAR)
    is_near = found.direct <= NEAR * found.diameter
    np.testing.assert_array_equal(np.isfinite(limited.direct), is_near)
    np.testing.assert_array_equal(limited.nearer, limited.direct)


def test_another_component_is_a_diameter_away(blob):
    count = len(blob.vertices)
    twice = Mesh(
        np.concatenate([blob.vertices, blob.vertices + 5]),
        np.concatenate([blob.faces, blob.faces + count]),
    )
    index = np.arange(2 * count)
    found = errors_on_target(Truth(twice, index), np.roll(index, count)[None])
    np.testing.assert_allclose(found.direct, found.diameter)
