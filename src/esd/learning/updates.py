"""Updates of a network by matches between the samples of two shapes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import torch

from esd.common import InputError
from esd.learning.model import Layer, Model
from esd.learning.network import linear_layers, seeded_network
from esd.learning.presets import Training
from esd.learning.samples import Samples
from esd.learning.teacher import Lesson, Rows

_NEAR = 0.04  # over √area: points nearer to each other than this are no negatives


@dataclass(frozen=True, slots=True, eq=False)
class Matches:
    """What a pair of shapes taught."""

    source: Samples
    target: Samples
    lesson: Lesson


def infonce_of_matches(
    network: torch.nn.Sequential,
    matches: Matches,
    training: Training,
    *,
    batch: int,
    generator: np.random.Generator,
    dropout: torch.Generator,
) -> torch.Tensor:
    """InfoNCE of some matches, between copies of the two shapes drawn at random.

    Weighed by how much of the map could be relied on; what is known is added to it. Points near
    each other are not distinguished.

    Parameters
    ----------
    training
        Whose temperature and dropout are used.
    batch
        Number of matches.
    generator, dropout
        Of the matches and copies, and of the descriptors that are set to zero.
    """
    known = matches.source.shared(matches.target)
    taught = matches.lesson.source, matches.lesson.target
    room = max(batch - len(known[0]), batch // 2)
    order = generator.permutation(len(taught[0]))[:room]
    also = generator.permutation(len(known[0]))[: batch // 2]
    source, target = (
        np.concatenate([rows[order], exact[also]])
        for rows, exact in zip(taught, known, strict=True)
    )
    weight = matches.lesson.returning * matches.lesson.kept
    embedded = []
    near = np.zeros((len(source), len(source)), dtype=bool)
    for shape, rows in ((matches.source, source), (matches.target, target)):
        values = torch.from_numpy(shape.values[generator.integers(len(shape.values))][rows])
        remaining = torch.rand(values.shape, generator=dropout) >= training.dropout
        output = network(values * remaining / (1 - training.dropout))
        embedded.append(torch.nn.functional.normalize(output, dim=1))
        near |= _are_near(shape.positions[rows])
    similarity = embedded[0] @ embedded[1].T / training.temperature
    np.fill_diagonal(near, False)
    similarity = similarity.masked_fill(torch.from_numpy(near), -torch.inf)
    ways = similarity.logsumexp(dim=0) + similarity.logsumexp(dim=1)
    return weight * (ways / 2 - similarity.diagonal()).mean()


def _are_near(positions: Rows) -> npt.NDArray[np.bool_]:
    """Whether any two points are too near to be distinguished, (b, b)."""
    squares = (positions**2).sum(axis=1)
    return squares[:, None] + squares - 2 * positions @ positions.T < _NEAR**2


def embedding_by(network: torch.nn.Sequential) -> Callable[[Rows], Rows]:
    """The function from standardised descriptors (p, width) to embeddings (p, d) of unit length."""

    def embed(values: Rows) -> Rows:
        with torch.no_grad():
            rows = torch.nn.functional.normalize(network(torch.from_numpy(values)), dim=1)
        return np.asarray(rows.numpy())

    return embed


def network_of(model: Model) -> torch.nn.Sequential:
    """A network with the weights of a model.

    Raises
    ------
    InputError
        If the model has convolutions, no layers, or embeddings that are not of unit length.
    """
    if model.patches is not None or not model.layers or not model.unit_length:
        raise InputError(
            f"'{model.name}' cannot learn without correspondences, as only fully connected models "
            "trained by InfoNCE can: take 'default', or one trained by the preset 'oriented'."
        )
    widths = [model.recipe.width, *(len(layer.bias) for layer in model.layers)]
    network = seeded_network(widths, 0)
    with torch.no_grad():
        for layer, known in zip(linear_layers(network), model.layers, strict=True):
            layer.weight.copy_(torch.from_numpy(known.weight))
            layer.bias.copy_(torch.from_numpy(known.bias))
    return network


def layers_of(network: torch.nn.Sequential) -> tuple[Layer, ...]:
    """The layers of a model with the weights of a network."""
    return tuple(
        Layer(layer.weight.detach().numpy(), layer.bias.detach().numpy())
        for layer in linear_layers(network)
    )
