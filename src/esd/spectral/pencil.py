"""The matrices of L φ = λ M φ: the stiffness L, and the mass M, lumped or consistent."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from scipy import sparse

from esd.common import FloatArray, InputError
from esd.spectral.laplacian import SparseMatrix

Mass: TypeAlias = Any
"""A lumped mass (n,), or a consistent one as `SparseMatrix` (n, n)."""


def shifted(stiffness: SparseMatrix, mass: Mass, shift: float) -> SparseMatrix:
    """L − σM in compressed columns."""
    matrix = mass if sparse.issparse(mass) else sparse.diags_array(mass)
    return sparse.csc_array(stiffness - shift * matrix)


def weighted(mass: Mass, rows: FloatArray) -> FloatArray:
    """The mass times each row of an array (b, n)."""
    if sparse.issparse(mass):
        return np.ascontiguousarray((mass @ rows.T).T)
    return np.asarray(rows * mass)


def checked_pencil(stiffness: Any, mass: Any) -> tuple[SparseMatrix, Mass]:
    """L in compressed columns, and M as an array (n,) if it is diagonal.

    Whether a consistent mass is positive definite is left to its factorisation.

    Raises
    ------
    InputError
        If the shapes do not fit, an entry is not finite, L is not symmetric or has a negative
        diagonal, or M is not symmetric or not positive on its diagonal.
    """
    if not sparse.issparse(stiffness):
        stiffness = np.asarray(stiffness)
        if stiffness.ndim != 2:
            raise InputError(
                f"`stiffness` must be a matrix (n, n); got an array of shape {stiffness.shape}."
            )
    stiffness = sparse.csc_array(stiffness, dtype=np.float64)
    n = stiffness.shape[0]
    if stiffness.shape != (n, n) or n == 0:
        raise InputError(f"`stiffness` must be a matrix (n, n); got shape {stiffness.shape}.")
    _check_symmetric("stiffness", stiffness)
    diagonal = stiffness.diagonal()
    if diagonal.min() < -1e-12 * abs(diagonal).max():
        row = int(np.argmin(diagonal))
        raise InputError(
            "`stiffness` must be positive semidefinite, but its diagonal is negative at "
            f"{row}: {diagonal[row]:.6g}. If it is the Laplacian Δ, pass −Δ."
        )
    if sparse.issparse(mass):
        mass = sparse.csc_array(mass, dtype=np.float64)
        if mass.shape != (n, n):
            raise InputError(f"`mass` must be (n,) or (n, n) with n = {n}; got {mass.shape}.")
        _check_symmetric("mass", mass)
        if mass.nnz == np.count_nonzero(mass.diagonal()):
            mass = mass.diagonal()
    else:
        mass = np.ascontiguousarray(mass, dtype=np.float64)
        if mass.shape != (n,):
            raise InputError(
                f"`mass` must be (n,), or a sparse matrix (n, n), with n = {n}; got {mass.shape}."
            )
    diagonal = mass.diagonal() if sparse.issparse(mass) else mass
    if not (np.isfinite(diagonal).all() and diagonal.min() > 0):
        row = int(np.argmin(np.where(np.isfinite(diagonal), diagonal, -np.inf)))
        raise InputError(
            f"`mass` must be positive; that of vertex {row} is {diagonal[row]}. Leave out "
            "vertices without a face, from the stiffness as well."
        )
    return stiffness, mass


def _check_symmetric(name: str, matrix: SparseMatrix) -> None:
    if not np.isfinite(matrix.data).all():
        raise InputError(f"`{name}` must be finite; {(~np.isfinite(matrix.data)).sum()} are not.")
    asymmetry = abs(matrix - matrix.T)
    if asymmetry.nnz and asymmetry.max() > 1e-10 * abs(matrix).max():
        raise InputError(
            f"`{name}` must be symmetric; it differs from its transpose by {asymmetry.max():.6g}. "
            "M⁻¹L is not symmetric: pass L and M."
        )
