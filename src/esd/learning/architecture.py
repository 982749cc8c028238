"""Training of many networks of different widths at once."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import torch

from esd.common import InputError
from esd.learning.losses import PairCriteria, contrastive_loss, pair_criteria
from esd.learning.network import linear_layers, seeded_network
from esd.learning.optimise import descend
from esd.learning.pairs import PairBatch, draw_pairs
from esd.learning.presets import Training
from esd.learning.table import PointTable
from esd.learning.train import learning_rate

_JUDGING = 2**32 - 1  # seed of the pairs that networks are judged on
_JUDGING_BATCHES = 20
_JUDGING_COUNT = 512

Networks = list[tuple[torch.Tensor, torch.Tensor]]
"""Weights (g, inputs, outputs) and biases (g, 1, outputs) of each layer of g networks."""


def train_many(
    table: PointTable, training: Training, hidden: Sequence[tuple[int, ...]], *, seed: int
) -> Networks:
    """Networks trained at once, each as `esd.learning.train.train` would alone, but for rounding.

    All start from the weights that the seed gives them alone, and see the same pairs. Layers are
    as wide as the widest; what a network lacks is zero and stays so: a unit whose weights and bias
    are zero has the value zero after ReLU, and its gradients vanish with it.

    Parameters
    ----------
    table
        Descriptors, standardised if they are to be.
    training
        Of each, but for `hidden`.
    hidden
        Neurons of the hidden layers of each network; all of one depth.

    Raises
    ------
    InputError
        If the networks differ in depth.
    """
    if len({len(widths) for widths in hidden}) != 1:
        raise InputError("Networks trained at once must have equally many hidden layers.")
    networks = _seeded(training, hidden, seed)
    parameters = [parameter.requires_grad_() for layer in networks for parameter in layer]
    optimiser = torch.optim.Adam(parameters, lr=training.learning_rate, fused=True)
    for step in range(training.steps):
        batch = draw_pairs(
            table,
            np.random.default_rng((seed, step)),
            count=training.batch,
            soft_label=training.soft_label,
        )
        squared = _squared_distances(networks, table, batch)
        label = torch.from_numpy(batch.label)
        loss = contrastive_loss(squared, label, margin=training.margin).sum()
        descend(optimiser, loss, rate=learning_rate(training, step))
    return [(weight.detach(), bias.detach()) for weight, bias in networks]


def judge_many(
    networks: Networks, table: PointTable, training: Training
) -> tuple[PairCriteria, ...]:
    """The paper's criteria of each network, on pairs drawn from a table, the same in each call."""
    squared, labels = [], []
    for step in range(_JUDGING_BATCHES):
        batch = draw_pairs(
            table,
            np.random.default_rng((_JUDGING, step)),
            count=_JUDGING_COUNT,
            soft_label=training.soft_label,
        )
        with torch.no_grad():
            squared.append(_squared_distances(networks, table, batch).double().numpy())
        labels.append(batch.label)
    label = np.concatenate(labels)
    return tuple(
        pair_criteria(row, label, margin=training.margin) for row in np.concatenate(squared, axis=1)
    )


def _seeded(training: Training, hidden: Sequence[tuple[int, ...]], seed: int) -> Networks:
    widest = [max(widths) for widths in zip(*hidden, strict=True)]
    sizes = [training.recipe.width, *widest, training.outputs]
    networks = [
        (torch.zeros(len(hidden), inputs, outputs), torch.zeros(len(hidden), 1, outputs))
        for inputs, outputs in pairwise(sizes)
    ]
    with torch.no_grad():
        for i, widths in enumerate(hidden):
            alone = seeded_network([training.recipe.width, *widths, training.outputs], seed)
            for (weight, bias), layer in zip(networks, linear_layers(alone), strict=True):
                weight[i, : layer.in_features, : layer.out_features] = layer.weight.T
                bias[i, 0, : layer.out_features] = layer.bias
    return networks


def _squared_distances(networks: Networks, table: PointTable, batch: PairBatch) -> torch.Tensor:
    """Squared distances of the embedded pairs, (networks, pairs)."""
    rows = table.values[np.concatenate([batch.source, batch.target])]
    embedded = torch.from_numpy(rows).expand(len(networks[0][0]), -1, -1)
    for i, (weight, bias) in enumerate(networks):
        embedded = torch.baddbmm(bias, embedded.relu() if i else embedded, weight)
    source, target = embedded.split(len(batch.source), dim=1)
    return ((source - target) ** 2).sum(dim=2)
