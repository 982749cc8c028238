import json
from dataclasses import replace

import numpy as np
import pytest

from esd.common import InputError
from esd.descriptors.recipe import Descriptor, Recipe, recipe_spectrum
from esd.learning.osd import optimal_metric, with_knots
from esd.learning.presets import PRESETS

OSD = replace(
    PRESETS["osd"], recipe=Recipe((Descriptor("hks", 12),), eigenpairs=20), outputs=4, steps=20
)


def gaussians(near, far, count=200_000):
    generator = np.random.default_rng(0)
    return tuple(
        generator.standard_normal((count, len(c))) @ np.linalg.cholesky(c).T for c in (near, far)
    )


def test_the_metric_of_independent_gaussians_is_known():
    # in units of its spread within a class, each axis on its own, the most telling first
    near, far = np.diag([4.0, 1.0, 0.25]), np.diag([8.0, 9.0, 1.0])
    metric = optimal_metric(*gaussians(near, far), 2, ridge=0)
    expected = [[0, 1, 0], [0, 0, 2]]
    np.testing.assert_allclose(np.abs(metric), expected, atol=0.02)  # 200,000 samples


def test_the_metric_is_what_it_says_whatever_the_axes():
    generator = np.random.default_rng(1)
    mixing = generator.standard_normal((5, 5))
    differences = gaussians(np.eye(5), mixing @ mixing.T + np.eye(5), count=1000)
    near, far = (d.T @ d / len(d) for d in differences)
    metric = optimal_metric(*differences, 3, ridge=0)
    np.testing.assert_allclose(metric @ near @ metric.T, np.eye(3), atol=1e-10)
    spread = metric @ far @ metric.T  # 1 / μ, the largest first, without correlation
    best = np.sort(np.linalg.eigvals(np.linalg.solve(near, far)).real)[::-1]
    np.testing.assert_allclose(spread, np.diag(best[:3]), atol=1e-9 * best[0])
    # other coordinates of the descriptors give the same distances
    turned = optimal_metric(*(d @ mixing for d in differences), 3, ridge=0)
    np.testing.assert_allclose(np.abs(turned @ mixing.T), np.abs(metric), rtol=1e-6)


def test_directions_without_difference_come_last():
    differences = [np.pad(d, ((0, 0), (0, 1))) for d in gaussians(np.eye(2), 9 * np.eye(2))]
    metric = optimal_metric(*differences, 2)
    assert np.abs(metric[:, 2]).max() < 1e-6


def test_more_outputs_than_descriptors_are_refused():
    with pytest.raises(InputError, match=r"`outputs` must be from 1 to 3, the descriptors; got 4"):
        optimal_metric(np.eye(3), np.eye(3), 4)


def test_knots_end_at_the_99th_percentile_of_the_eigenvalues(collection):
    recipe = Recipe((Descriptor("hks", 3), Descriptor("geometry", 10)), eigenpairs=20)
    found = with_knots(recipe, collection)
    values = [recipe_spectrum(recipe, shape.mesh()).eigenvalues for shape in collection.shapes]
    assert found.descriptors[0] == recipe.descriptors[0]
    assert found.descriptors[1].options == {"largest": np.percentile(values, 99)}
    assert with_knots(found, collection) is found
    assert Recipe.from_json(json.loads(json.dumps(found.to_json()))) == found
