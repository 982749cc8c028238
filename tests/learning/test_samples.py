from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from esd.learning.samples import collection_samples, moments, shape_samples
from esd.mesh.geometry import surface_area
from esd.mesh.io.landmarks import Landmarks
from knobbed import RECIPE, knobbed, knobbed_shape


def test_samples_hold_known_points_and_copies_at_the_same_places():
    describe = partial(
        shape_samples, recipe=RECIPE, points=200, eigenfunctions=30, copies=2, seed=0
    )
    first, second = (
        describe(knobbed_shape(seed, template="ball"), is_known=True) for seed in (0, 1)
    )
    source, target = first.shared(second)
    assert len(source) == len(target) == 400
    assert len(first.values) == 3
    assert {values.shape for values in first.values} == {(len(first.positions), RECIPE.width)}
    assert first.eigenvectors.shape == (len(first.positions), 30)
    assert len(first.closeness) == 32
    name = next(iter(first.closeness))
    assert first.closeness[name].argmax() == first.known[name]
    assert first.closeness[name].max() == pytest.approx(20)
    assert describe(knobbed_shape(0)).known == {}


def test_moments_are_those_of_all_points_and_copies(unregistered):
    described = collection_samples(
        unregistered, recipe=RECIPE, points=100, eigenfunctions=30, copies=1
    )
    values = np.concatenate([part for each in described.samples for part in each.values])
    mean, deviation = moments(described.samples)
    np.testing.assert_allclose(mean, values.mean(axis=0, dtype=float), rtol=1e-6)
    np.testing.assert_allclose(deviation, values.std(axis=0, dtype=float), rtol=1e-6)


def test_landmarks_are_known_points():
    landmarks = Landmarks(("nose", "ear", "lost"), np.array([5, 9, -1]))
    marked = replace(knobbed_shape(0), landmarks=lambda: landmarks)
    samples = shape_samples(marked, recipe=RECIPE, points=100, eigenfunctions=30, copies=0, seed=0)
    assert list(samples.known) == ["landmark nose", "landmark ear"]
    area = np.sqrt(surface_area(knobbed(0)))
    places = samples.positions[list(samples.known.values())]
    np.testing.assert_allclose(places, knobbed(0).vertices[[5, 9]] / area, rtol=1e-5)
