"""Wave kernel signature."""

from __future__ import annotations

import numpy as np

from esd.common import FloatArray, InputError
from esd.spectral.spectrum import Spectrum

_WIDTH = 7.0  # σ in units of the energy step


def wave_energies(spectrum: Spectrum, *, count: int = 100) -> tuple[FloatArray, float]:
    """Energies (count,), even in the logarithm of the eigenvalue, and the width σ.

    From ln λ_first to ln λ_last, with σ = 7 steps. λ_first is the first non-zero eigenvalue.

    Raises
    ------
    InputError
        If `count` is below two.
    """
    if count < 2:
        raise InputError(f"WKS needs at least two energies; got {count}.")
    values, _ = spectrum.nonzero()
    low, high = np.log(values[0]), np.log(values[-1])
    return np.linspace(low, high, count), float(_WIDTH * (high - low) / (count - 1))


def wks(spectrum: Spectrum, *, count: int = 100) -> FloatArray:
    """Wave kernel signature, (n, count): means of φ² weighted by exp(−(e − ln λ)² / 2 σ²).

    In units of 1 / area; scaling the shape changes nothing else, since the energies move with the
    eigenvalues. The constant modes, whose logarithm is −∞, take no part. The code that its authors
    published carries a notice of a patent.

    Parameters
    ----------
    count
        Number of energies, see `wave_energies`.

    References
    ----------
    Aubry, Schlickewei, Cremers 2011, *The wave kernel signature*; equations 4 to 6 of the paper,
    which leaves the width and the normalisation open.
    """
    energies, width = wave_energies(spectrum, count=count)
    values, vectors = spectrum.nonzero()
    weights = np.exp(-((energies - np.log(values)[:, None]) ** 2) / (2 * width**2))
    return vectors**2 @ (weights / weights.sum(axis=0))
