from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from esd.datasets.collection import Collection, Shape
from esd.learning.model import Model
from esd.learning.samples import collection_samples, moments
from esd.learning.teacher import Lesson
from esd.nearest import nearest
from knobbed import RECIPE, knobbed, truth

torch = pytest.importorskip("torch", reason="adapting needs the extra `train`")
from esd.learning import adapt  # noqa: E402
from esd.learning.network import seeded_network  # noqa: E402
from esd.learning.updates import embedding_by, layers_of, network_of  # noqa: E402


@pytest.fixture(scope="module")
def pair():
    """Samples of two shapes, standardised, at all of their vertices."""
    shapes = tuple(
        Shape(f"s{i}", f"s{i}", f"only {i}", partial(knobbed, i), partial(np.arange, 642))
        for i in (1, 2)
    )
    found = collection_samples(
        Collection("pair", shapes), recipe=RECIPE, points=642, eigenfunctions=60, copies=1
    ).samples
    mean, deviation = moments(found)
    return tuple(
        replace(
            each,
            values=tuple(((rows - mean) / deviation).astype(np.float32) for rows in each.values),
        )
        for each in found
    )


@pytest.fixture
def untrained() -> Model:
    zero, one = np.zeros(RECIPE.width), np.ones(RECIPE.width)
    layers = layers_of(seeded_network([RECIPE.width, 32, 16], 0))
    layers[0].weight[:, 3:] = 0.0  # it knows little
    return Model("untrained", RECIPE, zero, one, layers, limit=8.0, unit_length=True)


def error(model: Model, pair) -> float:
    """Mean distance of the nearest embeddings from the truth, over √area."""
    source, target = pair
    embed = embedding_by(network_of(model))
    index, _ = nearest(embed(source.values[0]), embed(target.values[0]))
    right = truth(1, 2)[source.vertices]
    place = np.empty((642, 3))
    place[target.vertices] = target.positions
    return float(np.linalg.norm(target.positions[index] - place[right], axis=1).mean())


def test_the_pair_itself_is_learned_from(pair, untrained, monkeypatch):
    monkeypatch.setattr(adapt, "_STEPS", 4)
    found = adapt.adapted(untrained, *pair)
    assert error(found, pair) < 0.9 * error(untrained, pair)
    assert len(found.layers) == len(untrained.layers)
    again = adapt.adapted(untrained, *pair)
    np.testing.assert_array_equal(again.layers[0].weight, found.layers[0].weight)


def test_without_a_map_that_can_be_relied_on_nothing_is_learned(pair, untrained, monkeypatch):
    monkeypatch.setattr(adapt, "_STEPS", 2)
    none = Lesson(np.array([], int), np.array([], int), 0.0, 0.0, 0.0)
    monkeypatch.setattr(adapt, "lesson", lambda *_, **__: none)
    for first in (None, none):
        found = adapt.adapted(untrained, *pair, first=first)
        np.testing.assert_array_equal(found.layers[0].weight, untrained.layers[0].weight)
    rows = np.arange(642)
    known = Lesson(rows, rows, 1.0, 1.0, 1.0)
    found = adapt.adapted(untrained, *pair, first=known)
    assert (found.layers[0].weight != untrained.layers[0].weight).any()
