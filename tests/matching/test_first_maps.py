from functools import partial

import numpy as np
import pytest
from scipy.sparse import csgraph

from esd.datasets.collection import Collection, Shape
from esd.learning.model import Layer, Model
from esd.learning.samples import collection_samples, moments
from esd.learning.teacher import FirstMaps
from esd.matching.first_maps import _pairs, first_maps, step_count
from esd.mesh.mesh import Mesh
from esd.mesh.shapes import torus
from knobbed import RECIPE, knobbed, truth


def shape(name: str, mesh: Mesh) -> Shape:
    return Shape(name, name, f"only {name}", lambda: mesh, partial(np.arange, len(mesh.vertices)))


@pytest.fixture(scope="module")
def collection() -> Collection:
    ring = torus(32, 20)
    return Collection(
        "mixed", (*(shape(f"s{seed}", knobbed(seed)) for seed in range(3)), shape("ring", ring))
    )


def test_chains_connect_shapes_of_one_class_and_their_maps_are_right(collection):
    samples = collection_samples(
        collection, recipe=RECIPE, points=500, eigenfunctions=40, copies=0
    ).samples
    steps = []
    found = first_maps(samples, collection, RECIPE, on_step=lambda: steps.append(1))
    assert len(steps) == step_count(4) == 4 + 6
    assert {pair for pair in found.chains if 3 not in pair} == {
        (i, j) for i in range(3) for j in range(3) if i != j
    }
    assert not [pair for pair in found.chains if 3 in pair]  # none to the ring, or from it
    assert found.lesson(samples, 0, 3) is None
    assert set(found.near) <= {(0, 1), (0, 2), (1, 2)}
    taught = found.lesson(samples, 0, 1)
    assert len(taught.source) > 100
    image = samples[1].vertices[taught.target]
    exact = truth(0, 1)[samples[0].vertices[taught.source]]
    away = knobbed(1).vertices[image] - knobbed(1).vertices[exact]
    assert np.linalg.norm(away, axis=1).mean() < 0.6  # the shapes are about six wide


@pytest.mark.parametrize("is_good", [True, False])
def test_the_training_starts_from_a_model_that_maps_the_shapes_better(collection, is_good):
    knobs = collection.including("s*")
    samples = collection_samples(
        knobs, recipe=RECIPE, points=500, eigenfunctions=40, copies=0
    ).samples
    width = RECIPE.width
    mean, deviation = moments(samples)
    # of all descriptors, or of one alone, which says little
    weight = np.eye(width) if is_good else np.eye(1, width) * 1e-3
    layers = (Layer(weight.astype(np.float32), np.zeros(len(weight), np.float32)),)
    start = Model("start", RECIPE, mean, deviation, layers, unit_length=True)
    found = first_maps(samples, knobs, RECIPE, start=start)
    assert found.start is (start if is_good else None)


def test_maps_along_a_chain_are_composed(collection):
    samples = collection_samples(
        collection.including("s*"), recipe=RECIPE, points=642, eigenfunctions=40, copies=0
    ).samples
    maps = {(i, j): truth(i, j) for i in range(3) for j in range(3) if i != j}
    ways = FirstMaps(maps, {(0, 2): (0, 1, 2), (2, 0): (2, 0)})
    taught = ways.lesson(samples, 0, 2)
    assert taught.returning == 1
    np.testing.assert_array_equal(taught.target, truth(0, 2)[taught.source])
    assert ways.lesson(samples, 0, 1) is None


def test_of_many_shapes_those_with_similar_spectra_and_some_others_are_mapped():
    assert step_count(5) == 5 + 10
    assert step_count(24) == 24 + 200
    assert step_count(60) == 60 + 300
    generator = np.random.default_rng(0)
    kinds = np.repeat([1.0, 3.0, 9.0], 20)
    eigenvalues = kinds[:, None] * generator.uniform(1.0, 1.1, size=(60, 10))
    pairs = _pairs(eigenvalues, seed=0)
    assert len(pairs) == len(set(pairs)) == 300
    assert all(i < j for i, j in pairs)
    same = np.array([kinds[i] == kinds[j] for i, j in pairs])
    assert same[:210].all()
    graph = np.zeros((60, 60))
    graph[tuple(np.transpose(pairs))] = 1
    assert csgraph.connected_components(graph, directed=False)[0] == 1


def test_a_mirrored_shape_is_connected_to_none(collection):
    mesh = knobbed(3)
    image = Mesh(mesh.vertices * [-1, 1, 1], mesh.faces[:, ::-1])
    some = Collection("mirrored", (*collection.shapes[:2], shape("mirrored", image)))
    samples = collection_samples(
        some, recipe=RECIPE, points=300, eigenfunctions=40, copies=0
    ).samples
    found = first_maps(samples, some, RECIPE)
    assert found.pairs() == [(0, 1)]
