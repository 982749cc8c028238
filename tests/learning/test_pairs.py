import numpy as np

from esd.descriptors.recipe import Descriptor, Recipe
from esd.learning.pairs import draw_matches, draw_pairs
from esd.learning.table import point_table

RECIPE = Recipe((Descriptor("hks", 12),), eigenpairs=20)


def test_half_of_the_pairs_correspond_and_labels_are_soft(collection):
    table = point_table(collection, RECIPE)
    batch = draw_pairs(table, np.random.default_rng(0), count=512, soft_label=0.2)
    size = len(collection.shapes[0].mesh().vertices)
    same = batch.source % size == batch.target % size
    np.testing.assert_array_equal(same, np.arange(512) < 256)
    assert (batch.label[:256] == 1).all()
    assert 0 <= batch.label[256:].min() < 0.02
    assert 0.18 < batch.label[256:].max() <= 0.2
    assert not (np.concatenate([batch.source, batch.target]) % size == 7).any()
    assert len({*(batch.source // size), *(batch.target // size)}) == 2  # two shapes


def test_matches_are_drawn_without_repetition(collection):
    table = point_table(collection, RECIPE)
    size = len(collection.shapes[0].mesh().vertices)
    batch = draw_matches(table, np.random.default_rng(0), count=10**6)
    assert sorted(batch.source % size) == [i for i in range(size) if i != 7]
    np.testing.assert_array_equal(batch.source % size, batch.target % size)
    assert batch.source[0] // size != batch.target[0] // size
