"""The network that embeds descriptors."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import torch
from torch import nn


def embedding_network(widths: Sequence[int]) -> nn.Sequential:
    """Fully connected layers of the given widths, input first, with ReLU between them.

    The branch of the paper's Siamese network (section 3.4), its figure 3.
    """
    layers: list[nn.Module] = []
    for i, (inputs, outputs) in enumerate(pairwise(widths)):
        if i:
            layers.append(nn.ReLU())
        layers.append(nn.Linear(inputs, outputs))
    return nn.Sequential(*layers)


def linear_layers(network: nn.Sequential) -> list[nn.Linear]:
    """The layers that have weights, in order."""
    return [layer for layer in network if isinstance(layer, nn.Linear)]


def seeded_network(widths: Sequence[int], seed: int) -> nn.Sequential:
    """An `embedding_network` with PyTorch's usual initial weights, drawn from a seed alone."""
    generator = torch.Generator().manual_seed(seed)
    network = embedding_network(widths)
    with torch.no_grad():
        for layer in linear_layers(network):
            bound = layer.in_features**-0.5
            layer.weight.uniform_(-bound, bound, generator=generator)
            layer.bias.uniform_(-bound, bound, generator=generator)
    return network
