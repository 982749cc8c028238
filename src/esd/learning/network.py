"""The network that embeds descriptors."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import torch
from torch import nn

from esd.common import FloatArray, IntArray
from esd.learning.gcnn import GeodesicPatches
from esd.learning.patches import Patches
from esd.spectral.laplacian import SparseMatrix


class Convolution(nn.Module):  # type: ignore[misc] # torch is untyped here
    """Filters over the patches of vertices, as `esd.learning.patches.convolution` applies them."""

    def __init__(self, inputs: int, outputs: int, patches: Patches) -> None:
        super().__init__()
        self.weight = nn.Parameter(torch.empty(outputs, *patches.bins, inputs))
        self.bias = nn.Parameter(torch.empty(outputs))
        self.turns = patches.bins[1] if isinstance(patches, GeodesicPatches) else 1

    def forward(self, patched: torch.Tensor) -> torch.Tensor:
        """Values (v, outputs) from those in the bins of patches, (v · bins, inputs)."""
        filters = torch.stack([self.weight.roll(turn, 2) for turn in range(self.turns)])
        outputs = len(self.bias)
        products = patched.reshape(-1, self.weight[0].numel()) @ filters.flatten(2).flatten(0, 1).T
        return products.reshape(-1, self.turns, outputs).amax(dim=1) + self.bias


class _SparseProduct(torch.autograd.Function):  # type: ignore[misc]
    """See `sparse_product`."""

    @staticmethod
    def forward(context: Any, values: torch.Tensor, operator: SparseMatrix) -> torch.Tensor:
        context.operator = operator
        return torch.from_numpy(operator @ values.detach().cpu().numpy()).to(values.device)

    @staticmethod
    def backward(context: Any, gradient: torch.Tensor) -> tuple[torch.Tensor, None]:
        moved = torch.from_numpy(context.operator.T @ gradient.cpu().numpy())
        return moved.to(gradient.device), None


def sparse_product(operator: SparseMatrix, values: torch.Tensor) -> torch.Tensor:
    """A constant matrix of scipy, (m, n), times values (n, c), which have a gradient."""
    return _SparseProduct.apply(values, operator)


def convolved(
    network: nn.Sequential, values: torch.Tensor, operator: SparseMatrix, vertices: IntArray
) -> torch.Tensor:
    """Embedding (b, outputs) of some vertices of a shape by a network with convolutions.

    Parameters
    ----------
    values : (n, width)
        Descriptors of all its vertices.
    operator : (n · bins, n)
        See `esd.learning.patches.patch_operator`.
    """
    bins = operator.shape[0] // operator.shape[1]
    last = max(i for i, layer in enumerate(network) if isinstance(layer, Convolution))
    for i, layer in enumerate(network):
        if isinstance(layer, Convolution):
            if i == last:  # what lies elsewhere is needed no more
                operator = operator[(vertices[:, None] * bins + np.arange(bins)).ravel()]
            values = sparse_product(operator, values)
        values = layer(values)
    return values


def embedding_network(
    widths: Sequence[int], patches: Patches | None = None, convolutions: Sequence[int] = ()
) -> nn.Sequential:
    """Layers of the given widths, input first, with ReLU between them.

    Fully connected, it is the branch of the paper's Siamese network (section 3.4), its figure 3.

    Parameters
    ----------
    patches, convolutions
        Which layers, from 0, are convolutions, and over what.
    """
    layers: list[nn.Module] = []
    for i, (inputs, outputs) in enumerate(pairwise(widths)):
        if i:
            layers.append(nn.ReLU())
        if i in convolutions and patches is not None:
            layers.append(Convolution(inputs, outputs, patches))
        else:
            layers.append(nn.Linear(inputs, outputs))
    return nn.Sequential(*layers)


def propagated(
    values: FloatArray, layers: Sequence[tuple[FloatArray, FloatArray]], *, device: str
) -> FloatArray:
    """Rows (n, inputs) after fully connected layers with ReLU between them, (n, outputs).

    Parameters
    ----------
    layers
        Weight (outputs, inputs) and bias (outputs,) of each.
    device
        Where torch computes.
    """
    rows = torch.from_numpy(values).to(device)
    for i, layer in enumerate(layers):
        weight, bias = (torch.from_numpy(array).to(rows) for array in layer)
        rows = nn.functional.linear(rows.relu() if i else rows, weight, bias)
    return np.asarray(rows.cpu().numpy())


def linear_layers(network: nn.Sequential) -> list[nn.Linear]:
    """The fully connected layers, in order."""
    return [layer for layer in network if isinstance(layer, nn.Linear)]


def seeded_network(
    widths: Sequence[int],
    seed: int,
    patches: Patches | None = None,
    convolutions: Sequence[int] = (),
) -> nn.Sequential:
    """An `embedding_network` with PyTorch's usual initial weights, drawn from a seed alone."""
    generator = torch.Generator().manual_seed(seed)
    network = embedding_network(widths, patches, convolutions)
    with torch.no_grad():
        for layer in network:
            if isinstance(layer, nn.Linear | Convolution):
                bound = layer.weight[0].numel() ** -0.5
                layer.weight.uniform_(-bound, bound, generator=generator)
                layer.bias.uniform_(-bound, bound, generator=generator)
    return network
