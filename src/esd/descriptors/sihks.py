"""Scale-invariant heat kernel signature."""

from __future__ import annotations

import numpy as np

from esd.common import FloatArray, InputError
from esd.spectral.spectrum import Spectrum

_BASE = 2.0
_EXPONENTS = np.linspace(1, 20, 96)  # 1, 1.2 … 20


def sihks(spectrum: Spectrum, *, count: int = 19, time_unit: float = 2.0**-18) -> FloatArray:
    """Scale-invariant heat kernel signature, (n, count), free of units.

    Over time on a logarithmic scale, scaling the shape shifts and offsets the logarithm of the
    heat kernel signature. Its derivative has no offset, and the magnitudes of the derivative's
    Fourier transform know no shift. At times t = u αᵗᵃᵘ with α = 2 and τ = 1, 1.2 … 20:

        s(τ) = −ln α · Σ t λ exp(−t λ) φ² / Σ exp(−t λ) φ²

    Parameters
    ----------
    count
        Number of frequencies, from the second one on.
    time_unit
        u, in units of area. The default lets the times reach from far below to far above those at
        which a shape of unit area with 300 eigenpairs changes, so that s vanishes at both ends,
        without which a shift would not leave the magnitudes as they are.

    Raises
    ------
    InputError
        If `count` is more than the transform has, 47.

    References
    ----------
    Bronstein, Kokkinos 2010, *Scale-invariant heat kernel signatures for non-rigid shape
    recognition*, equations 8 to 11.
    """
    available = len(_EXPONENTS) // 2 - 1
    if not 1 <= count <= available:
        raise InputError(f"SI-HKS has 1 to {available} frequencies; got {count}.")
    exponent = np.outer(spectrum.eigenvalues, time_unit * _BASE**_EXPONENTS)
    squared = spectrum.eigenvectors**2
    heat = squared @ np.exp(-exponent)
    change = -np.log(_BASE) * (squared @ (exponent * np.exp(-exponent)))
    slope = np.divide(change, heat, out=np.zeros_like(heat), where=heat > 0)
    return np.asarray(np.abs(np.fft.rfft(slope, axis=1))[:, 1 : count + 1])
