"""The network of `esd.learning.diffusion` as torch trains it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import torch
from scipy import sparse
from torch import nn

from esd.common import FloatArray
from esd.learning.diffusion import GRADIENT_UNIT
from esd.learning.network import sparse_product
from esd.spectral.laplacian import SparseMatrix

_SHORTEST, _LONGEST = 1e-3, 0.3  # times of diffusion at first, in units of area
_INPUT_DROPOUT = 0.3  # share of the descriptors of each vertex that are set to zero
_COLUMN_DROPOUT = 0.1  # share of the descriptors that are zero at all vertices of a shape
_BLOCK_DROPOUT = 0.1  # share of the features between the two layers of a block


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceTensors:
    """An `esd.learning.diffusion.Surface` as tensors.

    Parameters
    ----------
    eigenvalues : (k,)
    eigenvectors : (n, k)
    mass : (n,)
    gradient : (2n, n)
        The real part of each vertex, and after those of all the imaginary ones; of scipy.
    """

    eigenvalues: torch.Tensor
    eigenvectors: torch.Tensor
    mass: torch.Tensor
    gradient: SparseMatrix


def surface_tensors(
    eigenvalues: FloatArray,
    eigenvectors: FloatArray,
    mass: FloatArray,
    gradient: SparseMatrix,
    *,
    device: torch.device,
) -> SurfaceTensors:
    """The tensors of arrays, float32.

    Parameters
    ----------
    gradient
        Complex, (n, n).
    """
    parts = [gradient.real, gradient.imag]
    operator = sparse.vstack(parts, format="csr", dtype=np.float32)

    def single(array: FloatArray) -> torch.Tensor:
        return torch.from_numpy(array.astype(np.float32, copy=False)).to(device)

    return SurfaceTensors(single(eigenvalues), single(eigenvectors), single(mass), operator)


class _Block(nn.Module):  # type: ignore[misc]
    """A block of `esd.learning.diffusion.DiffusionNetwork`, whose names its parameters have."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.norm = nn.LayerNorm(width)
        times = torch.from_numpy(np.geomspace(_SHORTEST, _LONGEST, width)).float()
        self.time = nn.Parameter(times.log()[torch.randperm(width)])
        self.real, self.imaginary = (
            nn.Parameter(nn.Linear(width, width, bias=False).weight.detach()) for _ in range(2)
        )
        self.first = nn.Linear(3 * width, width)
        self.second = nn.Linear(width, width)

    def forward(
        self, values: torch.Tensor, surface: SurfaceTensors, dropout: torch.Generator | None
    ) -> torch.Tensor:
        normal = self.norm(values)
        vectors = surface.eigenvectors
        spectral = vectors.T @ (surface.mass[:, None] * normal)
        decay = torch.exp(-surface.eigenvalues[:, None] * self.time.exp())
        diffused = vectors @ (decay * spectral)
        # complex products by their parts: gradients (x, y), and the same turned
        x, y = (sparse_product(surface.gradient, diffused) * GRADIENT_UNIT).chunk(2)
        turned_x = x @ self.real.T - y @ self.imaginary.T
        turned_y = y @ self.real.T + x @ self.imaginary.T
        angles = torch.tanh(x * turned_x + y * turned_y)
        mixed = self.first(torch.cat([normal, diffused, angles], dim=1)).relu()
        return values + self.second(_thinned(mixed, _BLOCK_DROPOUT, dropout))


class DiffusionLayers(nn.Module):  # type: ignore[misc]
    """The layers of `esd.learning.diffusion.DiffusionNetwork`, whose names its parameters have."""

    def __init__(self, inputs: int, hidden: int, width: int, outputs: int, blocks: int) -> None:
        super().__init__()
        self.first = nn.Linear(inputs, hidden)
        self.second = nn.Linear(hidden, width)
        self.block_count = blocks
        for block in range(blocks):
            self.add_module(str(block), _Block(width))
        self.out = nn.Linear(width, outputs)

    def forward(
        self,
        values: torch.Tensor,
        surface: SurfaceTensors,
        dropout: torch.Generator | None = None,
    ) -> torch.Tensor:
        """Features (n, outputs) of standardised descriptors (n, inputs) of all vertices.

        Some of them are dropped at random if there is a generator.
        """
        if dropout is not None:
            values = _thinned(values, _INPUT_DROPOUT, dropout)
            column = torch.rand(values.shape[1], generator=dropout, device=values.device)
            values = values * (column >= _COLUMN_DROPOUT)
        values = self.second(self.first(values).relu())
        for block in range(self.block_count):
            values = self.get_submodule(str(block))(values, surface, dropout)
        return self.out(values)

    def arrays(self) -> dict[str, npt.NDArray[np.float32]]:
        """The weights of the `esd.learning.diffusion.DiffusionNetwork` that is equal."""
        state = self.state_dict()
        return {name: tensor.cpu().numpy().copy() for name, tensor in state.items()}


def seeded_layers(
    inputs: int, hidden: int, width: int, outputs: int, blocks: int, *, seed: int
) -> DiffusionLayers:
    """Layers with PyTorch's usual initial weights, drawn from a seed alone."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        return DiffusionLayers(inputs, hidden, width, outputs, blocks)


def _thinned(values: torch.Tensor, share: float, generator: torch.Generator | None) -> torch.Tensor:
    """Values of which a share is set to zero, and the others grow as much."""
    if generator is None:
        return values
    kept = torch.rand(values.shape, generator=generator, device=values.device) >= share
    return values * kept / (1 - share)
