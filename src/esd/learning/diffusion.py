"""A network that diffuses features over a surface, at work without torch."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from esd.common import FloatArray, InputError
from esd.mesh.geometry import surface_area
from esd.mesh.mesh import Mesh
from esd.spectral.gradient import gradient_operator
from esd.spectral.laplacian import SparseMatrix
from esd.spectral.spectrum import Spectrum

EIGENPAIRS = 128
"""Number of eigenpairs by which features are diffused."""

GRADIENT_UNIT = 0.1
"""Length, in √area, per which gradients are taken."""

_NORM_FLOOR = 1e-5  # added to variances, as torch does


@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """What a `DiffusionNetwork` takes of a shape beside its descriptors.

    Parameters
    ----------
    spectrum
        Whose area is the shape's share of the whole that it is part of.
    gradient : (n, n) complex
        See `esd.spectral.gradient.gradient_operator`, in the units of the spectrum.
    """

    spectrum: Spectrum
    gradient: SparseMatrix


def surface_of(mesh: Mesh, spectrum: Spectrum) -> Surface:
    """The operators of a mesh, in the units of length of its spectrum."""
    unit = np.sqrt(spectrum.area / surface_area(mesh))
    few = spectrum.truncated(min(EIGENPAIRS, len(spectrum.eigenvalues)))
    return Surface(few, gradient_operator(mesh) / unit)


@dataclass(frozen=True, slots=True, eq=False)
class DiffusionNetwork:
    """Blocks that diffuse features, compare their gradients, and mix them at each vertex.

    Each of its blocks (Sharp et al. 2022, *DiffusionNet*) lets every feature flow for a learned
    time, by the eigenfunctions; takes inner products of the gradients of the results, rotated and
    scaled by learned complex numbers, which tells left from right; and adds to each vertex's
    features what two layers make of these three.

    Parameters
    ----------
    weights
        float32 arrays by name: `first` and `second` of the descriptors, `out`, and of each block
        b `b.norm`, `b.time` (logarithms, in units of area), `b.real`, `b.imaginary`, `b.first`,
        `b.second`; those of layers with `.weight` (outputs, inputs) and `.bias`.
    """

    weights: Mapping[str, npt.NDArray[np.float32]]

    @property
    def block_count(self) -> int:
        """Number of blocks."""
        return sum(name.endswith(".time") for name in self.weights)

    def __call__(self, values: FloatArray, surface: Surface) -> FloatArray:
        """Embedding (n, outputs) of standardised descriptors (n, inputs) of all vertices."""
        return self.diffused(self.features(values), surface)

    def features(self, values: FloatArray) -> FloatArray:
        """Features (n, width) of standardised descriptors (n, inputs), of each by itself."""
        values = np.maximum(self._layer("first", values.astype(np.float32, copy=False)), 0)
        return self._layer("second", values)

    def diffused(self, values: FloatArray, surface: Surface) -> FloatArray:
        """Embedding (n, outputs) of the `features` (n, width) of all vertices."""
        spectrum = surface.spectrum
        vectors = spectrum.eigenvectors.astype(np.float32)
        weighted = (vectors * spectrum.mass[:, None].astype(np.float32)).T
        gradient = surface.gradient.astype(np.complex64)
        for block in range(self.block_count):
            normal = self._normalised(f"{block}.norm", values)
            times = np.exp(self.weights[f"{block}.time"])
            decay = np.exp(-spectrum.eigenvalues[:, None].astype(np.float32) * times)
            diffused = vectors @ (decay * (weighted @ normal))
            slopes = (gradient @ diffused) * np.complex64(GRADIENT_UNIT)
            turn = self.weights[f"{block}.real"] + 1j * self.weights[f"{block}.imaginary"]
            angles = np.tanh((slopes.conj() * (slopes @ turn.T)).real)
            inputs = np.concatenate([normal, diffused, angles], axis=1)
            mixed = np.maximum(self._layer(f"{block}.first", inputs), 0)
            values = values + self._layer(f"{block}.second", mixed)
        return self._layer("out", values)

    def _layer(self, name: str, values: FloatArray) -> FloatArray:
        return values @ self.weights[f"{name}.weight"].T + self.weights[f"{name}.bias"]

    def _normalised(self, name: str, values: FloatArray) -> FloatArray:
        centred = values - values.mean(axis=1, keepdims=True)
        deviation = np.sqrt((centred**2).mean(axis=1, keepdims=True) + _NORM_FLOOR)
        return centred / deviation * self.weights[f"{name}.weight"] + self.weights[f"{name}.bias"]


def diffusion_network(
    weights: Mapping[str, npt.NDArray[np.float32]], *, inputs: int
) -> DiffusionNetwork:
    """The network of some weights.

    Raises
    ------
    InputError
        If weights are missing, not finite, of wrong shapes, or too many.
    """
    found = DiffusionNetwork(weights)
    try:
        hidden, width = (len(weights[f"{name}.bias"]) for name in ("first", "second"))
        expected = {"first": (hidden, inputs), "second": (width, hidden)}
        expected["out"] = (len(weights["out.bias"]), width)
    except (KeyError, TypeError) as error:
        raise InputError(f"The network lacks weights: {error}.") from error
    shapes: dict[str, tuple[int, ...]] = {}
    for block in range(found.block_count):
        expected |= {f"{block}.first": (width, 3 * width), f"{block}.second": (width, width)}
        shapes |= {f"{block}.norm.{name}": (width,) for name in ("weight", "bias")}
        shapes |= {f"{block}.{name}": (width, width) for name in ("real", "imaginary")}
        shapes[f"{block}.time"] = (width,)
    for name, shape in expected.items():
        shapes |= {f"{name}.weight": shape, f"{name}.bias": shape[:1]}
    if {name: array.shape for name, array in weights.items()} != shapes:
        raise InputError("The weights of the network do not fit each other.")
    if not all(array.dtype.kind == "f" and np.isfinite(array).all() for array in weights.values()):
        raise InputError("The weights of the network are not all finite: the training diverged.")
    return found
