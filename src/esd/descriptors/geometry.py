"""Geometry vector: the squared eigenvectors by bands of the spectrum."""

from __future__ import annotations

import numpy as np

from esd.common import FloatArray, InputError
from esd.spectral.spectrum import Spectrum


def geometry_vector(
    spectrum: Spectrum, *, count: int = 150, largest: float | None = None
) -> FloatArray:
    """Geometry vector, (n, count), of length one at each vertex: Σ B((λ − s) / Δ) φ².

    B is the cubic B-spline, centred at zero, and s are `count` evenly spaced frequencies from zero
    to `largest`, Δ apart. From Δ to `largest` − Δ the splines add up to one. (The authors' spline
    begins at s, which leaves the lowest frequencies to a single component.)

    Parameters
    ----------
    largest
        In units of 1 / area. Vectors compare only if they share it. The authors take the 99th
        percentile of the eigenvalues of all training shapes, as `esd.learning.osd.with_knots`
        does. By default 99 % of what Weyl's law gives for the last eigenvalue, 4π k / area, which
        needs no training shapes.

    Raises
    ------
    InputError
        If there are fewer than two components, or `largest` is not positive.

    References
    ----------
    Litman, Bronstein 2014, *Learning spectral descriptors for deformable shape correspondence*.
    """
    if largest is None:
        largest = 0.99 * 4 * np.pi * (len(spectrum.eigenvalues) - 1) / spectrum.area
    if count < 2 or not largest > 0:
        raise InputError(
            "A geometry vector needs two components or more and a positive `largest`; "
            f"got {count} and {largest}."
        )
    centres, step = np.linspace(0, largest, count, retstep=True)
    bands = cubic_spline((spectrum.eigenvalues[:, None] - centres) / step)
    values = spectrum.eigenvectors**2 @ bands
    length = np.linalg.norm(values, axis=1, keepdims=True)
    return np.asarray(values / np.maximum(length, np.finfo(float).tiny))


def cubic_spline(x: FloatArray) -> FloatArray:
    """The cubic B-spline at x, of any shape, with knots at the integers from −2 to 2."""
    distance = np.abs(x)
    return np.asarray((np.maximum(2 - distance, 0) ** 3 - 4 * np.maximum(1 - distance, 0) ** 3) / 6)
