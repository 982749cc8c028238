"""Maps of functions: a small matrix in place of a map of points, and back."""

from __future__ import annotations

import numpy as np

from esd.common import FloatArray, InputError, IntArray
from esd.spectral.spectrum import Spectrum

_RIDGE = 1e-6  # for samples of hardly more points than functions


def functional_map(
    source: Spectrum, target: Spectrum, target_index: IntArray, *, size: int
) -> FloatArray:
    """The matrix C (size, size) that takes functions of the target to functions of the source.

    C = Φₛᵀ Mₛ Φₜ[T], for the spectra of unit area: the projection of a map T to as many
    eigenfunctions. A map between isometric shapes has an orthogonal C that commutes with the
    eigenvalues.

    Parameters
    ----------
    target_index : (n,)
        T; source vertices of index −1 have no part.
    size
        Number of eigenfunctions of either shape.

    Raises
    ------
    InputError
        If a spectrum has fewer eigenpairs, or the map has no match.

    References
    ----------
    Ovsjanikov et al. 2012, *Functional maps: a flexible representation of maps between shapes*.
    """
    available = min(len(source.eigenvalues), len(target.eigenvalues))
    if not 1 <= size <= available:
        raise InputError(f"`size` must be from 1 to {available}, the eigenpairs; got {size}.")
    matched = target_index >= 0
    if not matched.any():
        raise InputError("The map has no match.")
    source, target = source.with_area(1.0), target.with_area(1.0)
    weighted = source.eigenvectors[matched, :size]
    weighted = source.mass[matched, None].astype(weighted.dtype) * weighted
    return np.asarray(weighted.T @ target.eigenvectors[target_index[matched], :size])


def fitted_map(
    source: Spectrum, target: Spectrum, target_index: IntArray, *, size: int
) -> FloatArray:
    """As `functional_map`, of shapes of which the spectra have a sample of the vertices only.

    There the eigenfunctions are not orthonormal, and the projection is the solution of a least
    squares problem: C = (Φₛᵀ Mₛ Φₛ)⁻¹ Φₛᵀ Mₛ Φₜ[T].

    Raises
    ------
    InputError
        As `functional_map` does.
    """
    projected = functional_map(source, target, target_index, size=size)
    matched = target_index >= 0
    rows = source.with_area(1.0).eigenvectors[matched, :size]
    overlap = (source.mass[matched, None].astype(rows.dtype) * rows).T @ rows
    overlap[np.diag_indices(size)] += _RIDGE * np.trace(overlap) / size
    return np.asarray(np.linalg.solve(overlap, projected))


def spectral_rows(
    source: Spectrum, target: Spectrum, functional: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Rows of the vertices of both shapes, (n, k) and (m, k), which are close where they match.

    Those of the source are the rows of Φₛ, those of the target the rows of Φₜ Cᵀ, both for unit
    area, so that the squares of a row are about k; NaN at vertices without a face. Taking Φₛ C
    and Φₜ instead looks alike, and its maps are clearly worse.

    Parameters
    ----------
    functional : (k, k)
        C, see `functional_map`.
    """
    size = len(functional)
    rows = source.with_area(1.0).eigenvectors[:, :size].copy()
    candidates = target.with_area(1.0).eigenvectors[:, :size] @ functional.T
    rows[source.mass == 0], candidates[target.mass == 0] = np.nan, np.nan
    return rows, candidates
