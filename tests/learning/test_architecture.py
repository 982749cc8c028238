from dataclasses import replace

import numpy as np
import pytest

from esd.common import InputError
from esd.descriptors.recipe import Descriptor, Recipe
from esd.learning.losses import pair_criteria
from esd.learning.pairs import draw_pairs
from esd.learning.presets import Training
from esd.learning.table import PointTable

torch = pytest.importorskip("torch", reason="training needs the extra `train`")
from esd.learning import train as alone  # noqa: E402
from esd.learning.architecture import judge_many, train_many  # noqa: E402
from esd.learning.run import weights_of  # noqa: E402

TRAINING = Training(Recipe((Descriptor("hks", 12),)), hidden=(), outputs=4, batch=32, steps=25)
HIDDEN = [(9, 5), (7, 7), (12, 2)]


@pytest.fixture
def table():
    """Three shapes of 40 corresponding points, each a little different."""
    generator = np.random.default_rng(0)
    points = generator.standard_normal((40, 12))
    values = np.concatenate([points + 0.1 * generator.standard_normal((40, 12)) for _ in range(3)])
    rows = tuple(np.arange(40) + 40 * i for i in range(3))
    return PointTable(values.astype(np.float32), rows, np.zeros(3, dtype=int))


@pytest.mark.parametrize("hidden", [HIDDEN, [(6,), (3,)], [(6, 5, 5), (3, 3, 3)]])
def test_networks_trained_at_once_are_those_trained_alone(table, hidden):
    # a bias that acts on both points of every pair alike has no gradient but rounding, which Adam
    # makes a step of full length: after more than two steps the trainings part by chance
    short = replace(TRAINING, steps=2)
    together = train_many(table, short, hidden, seed=3)
    for i, widths in enumerate(hidden):
        training = replace(short, hidden=widths)
        run = alone._start(training, 3, torch.device("cpu"))
        alone._advance(run, table, training, 3)
        layers = alone._layers(weights_of(run.network))
        for (weight, bias), layer in zip(together, layers, strict=True):
            outputs, inputs = layer.weight.shape
            np.testing.assert_allclose(weight[i, :inputs, :outputs].T, layer.weight, atol=1e-6)
            assert not weight[i, inputs:].any()
            assert not weight[i, :, outputs:].any()
            assert not bias[i, 0, outputs:].any()


def test_what_a_network_lacks_stays_zero_and_the_rest_learns(table):
    before, after = (
        train_many(table, replace(TRAINING, steps=steps), HIDDEN, seed=0) for steps in (1, 300)
    )
    for (weight, bias), place in zip(after, range(3), strict=True):
        for i, widths in enumerate(HIDDEN):
            sizes = (12, *widths, 4)
            assert not weight[i, sizes[place] :].any()
            assert not bias[i, 0, sizes[place + 1] :].any()
    for old, new in zip(
        judge_many(before, table, TRAINING), judge_many(after, table, TRAINING), strict=True
    ):
        assert new.loss_mean < 0.5 * old.loss_mean


def test_criteria_are_those_of_each_network(table):
    networks = train_many(table, TRAINING, HIDDEN, seed=0)
    found = judge_many(networks, table, TRAINING)
    squared, labels = [], []
    for step in range(20):
        batch = draw_pairs(
            table, np.random.default_rng((2**32 - 1, step)), count=512, soft_label=0.2
        )
        embedded = table.values
        for j, (weight, bias) in enumerate(networks):
            embedded = np.maximum(embedded, 0) if j else embedded
            embedded = embedded @ weight[1].numpy() + bias[1].numpy()
        squared.append(((embedded[batch.source] - embedded[batch.target]) ** 2).sum(axis=1))
        labels.append(batch.label)
    expected = pair_criteria(np.concatenate(squared), np.concatenate(labels), margin=5.0)
    assert found[1].loss_mean == pytest.approx(expected.loss_mean, rel=1e-4)  # single precision
    assert found[1].error_rate == pytest.approx(expected.error_rate, abs=1e-3)
    assert len({criteria.loss_sum for criteria in found}) == 3


def test_networks_of_several_depths_are_refused(table):
    with pytest.raises(InputError, match="equally many hidden layers"):
        train_many(table, TRAINING, [(5,), (5, 5)], seed=0)
