"""Heat kernel signature."""

from __future__ import annotations

import numpy as np

from esd.common import FloatArray, InputError
from esd.spectral.spectrum import Spectrum


def heat_times(spectrum: Spectrum, *, count: int = 100) -> FloatArray:
    """Times (count,) spaced evenly in logarithm from 4 ln 10 / λ_last to 4 ln 10 / λ_first.

    λ_first is the first non-zero eigenvalue. Times have units of area.
    """
    values, _ = spectrum.nonzero()
    return np.geomspace(4 * np.log(10) / values[-1], 4 * np.log(10) / values[0], count)


def hks(
    spectrum: Spectrum,
    *,
    times: FloatArray | None = None,
    count: int = 100,
) -> FloatArray:
    """Heat kernel signature, (n, t): Σ exp(−λ t) φ², the constant modes included.

    In units of 1 / area: for the shape scaled by s, at times scaled by s², it is divided by s².

    Parameters
    ----------
    times : (t,), optional
        In units of area; by default `heat_times` with `count`.

    Raises
    ------
    InputError
        If a time is not positive.

    References
    ----------
    Sun, Ovsjanikov, Guibas 2009, *A concise and provably informative multi-scale signature based
    on heat diffusion*; equations 2 and 3 of the paper.
    """
    times = heat_times(spectrum, count=count) if times is None else np.asarray(times, dtype=float)
    if times.ndim != 1 or not (times > 0).all():
        raise InputError(f"`times` must be a list of positive numbers; got {times}.")
    return spectrum.eigenvectors**2 @ np.exp(-np.outer(spectrum.eigenvalues, times))
