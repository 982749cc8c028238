"""Refinement of maps in the spectral domain."""

from __future__ import annotations

import numpy as np

from esd.common import InputError, IntArray
from esd.matching.nearest import nearest
from esd.spectral.spectrum import Spectrum


def zoomout(
    source: Spectrum,
    target: Spectrum,
    target_index: IntArray,
    *,
    first: int = 100,
    last: int = 300,
    step: int = 20,
) -> IntArray:
    """The target vertex of each source vertex, (n,), refined with more and more eigenfunctions.

    With k eigenfunctions and the map T: C = Φₛᵀ Mₛ Φₜ[T], and then T(x) is the row of Φₜ Cᵀ nearest
    to row x of Φₛ. The first map must be right about left and right; a map that is not is made
    smooth on the wrong side. Shapes are taken as nearly isometric.

    Parameters
    ----------
    target_index : (n,)
        The map to refine; -1 where there is none, which the result fills.
    first, last, step
        Numbers of eigenfunctions; no more than both shapes have are used.

    Raises
    ------
    InputError
        If the numbers are not ascending, or the map has no match.

    References
    ----------
    Melzi et al. 2019, *ZoomOut: spectral upsampling for efficient shape correspondence*.
    """
    if not (1 <= first <= last and step >= 1):
        raise InputError(f"Expected 1 ≤ first ≤ last and step ≥ 1; got {first}, {last}, {step}.")
    matched = target_index >= 0
    if not matched.any():
        raise InputError("A map without a match cannot be refined.")
    source, target = source.with_area(1.0), target.with_area(1.0)
    available = min(len(source.eigenvalues), len(target.eigenvalues), last)
    sizes = [*range(min(first, available), available, step), available]
    defined = source.mass > 0
    index = target_index
    for k in sizes:
        weighted = source.mass[matched, None] * source.eigenvectors[matched, :k]
        functional = weighted.T @ target.eigenvectors[index[matched], :k]
        rows = np.where(defined[:, None], source.eigenvectors[:, :k], np.nan)
        candidates = target.eigenvectors[:, :k] @ functional.T
        index, _ = nearest(rows, np.where(target.mass[:, None] > 0, candidates, np.nan))
        matched = defined
    return index
