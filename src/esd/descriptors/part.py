"""Descriptors of parts of shapes, at fixed scales of the whole, which a cut changes little."""

from __future__ import annotations

import numpy as np

from esd.common import FloatArray
from esd.descriptors.chirality import Parity, gradient_products, neighbour_pairs
from esd.mesh.mesh import Mesh
from esd.spectral.spectrum import Spectrum

_TIMES = np.geomspace(0.0024, 6.0, 66)  # in units of the whole's area
_ENERGIES = np.linspace(np.log(1.5), np.log(3000.0), 68)  # log λ, likewise
_WIDTH = 7.0  # of a wave kernel, in steps between energies
_CONSTANT = 1e-3  # eigenvalue below which a wave kernel leaves an eigenfunction out
_FLOOR = 1e-12
_HKS_OF_RATIO, _WKS_OF_RATIO = slice(None, None, 3), slice(None, None, 4)
_HKS_OF_PRODUCT, _WKS_OF_PRODUCT = slice(None, None, 5), slice(None, 65, 5)
_REACH = 3  # each field is multiplied with as many after it
_PRODUCT_TIMES: dict[Parity, tuple[float, ...]] = {
    "odd": (1e-3, 2e-3, 4e-3, 1.6e-2, 6e-2),
    "even": (1e-3, 4e-3, 1.6e-2),
}

PART_WIDTH = 725
"""Number of components of `part_descriptors`."""


def part_descriptors(mesh: Mesh, neumann: Spectrum, dirichlet: Spectrum | None) -> FloatArray:
    """Values at the vertices of a part of a shape, or of a whole one, (n, PART_WIDTH).

    Logarithms of the heat kernel signature, and of the wave kernel signature over the density of
    eigenvalues, at times and energies fixed in units of the whole's area, so that they are the
    same on a part and on the whole where both are alike. Each is the mean of the one under Neumann
    and the one under Dirichlet conditions, in which the effect of the boundary cancels to first
    order. Their difference over their sum follows: it says how far up the boundary is felt. At
    last come the products of the gradients of neighbouring components, see
    `esd.descriptors.chirality.gradient_products`.

    Parameters
    ----------
    mesh
        Consistently oriented.
    neumann, dirichlet
        Spectra of the mesh, whose area is its share of the whole's; no second where the mesh has
        no boundary.
    """
    area = neumann.area
    both = [neumann, neumann if dirichlet is None else dirichlet]
    heat = [_heat(spectrum) for spectrum in both]
    kernels, waves = zip(*(_waves(spectrum) for spectrum in both), strict=True)
    density = sum(kernel.sum(axis=0) for kernel in kernels) / 2 / area
    log_heat = np.log(np.maximum((heat[0] + heat[1]) / 2 * _TIMES * 4 * np.pi, _FLOOR))
    log_waves = np.log(np.maximum((waves[0] + waves[1]) / 2 / density, _FLOOR))
    parts = [
        log_heat,
        log_waves,
        _ratio(*heat)[:, _HKS_OF_RATIO],
        _ratio(*waves)[:, _WKS_OF_RATIO],
    ]
    fields = log_heat[:, _HKS_OF_PRODUCT], log_waves[:, _WKS_OF_PRODUCT]
    for parity, times in _PRODUCT_TIMES.items():
        parts += [
            gradient_products(
                mesh,
                neumann,
                field,
                pairs=neighbour_pairs(field.shape[1], reach=_REACH),
                times=np.array(times) / area,  # these are shares of the area of the mesh
                parity=parity,
            )
            for field in fields
        ]
    return np.nan_to_num(np.hstack(parts))


def _heat(spectrum: Spectrum) -> FloatArray:
    return spectrum.eigenvectors**2 @ np.exp(-spectrum.eigenvalues[:, None] * _TIMES)


def _waves(spectrum: Spectrum) -> tuple[FloatArray, FloatArray]:
    """Weights of the eigenfunctions, (k, energies), and the wave kernel signature."""
    used = spectrum.eigenvalues > _CONSTANT
    deviation = _WIDTH * (_ENERGIES[1] - _ENERGIES[0])
    away = _ENERGIES - np.log(spectrum.eigenvalues[used, None])
    kernel = np.exp(-(away**2) / (2 * deviation**2))
    return kernel, spectrum.eigenvectors[:, used] ** 2 @ kernel


def _ratio(neumann: FloatArray, dirichlet: FloatArray) -> FloatArray:
    return (neumann - dirichlet) / (neumann + dirichlet + 1e-9)
