"""Factorised shifted stiffness L − σM: it solves, and it counts the eigenvalues below σ."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.sparse.linalg import splu

from esd.common import FloatArray, InputError
from esd.spectral.laplacian import SparseMatrix
from esd.spectral.pencil import Mass, shifted

_STABLE = 1e-10  # largest backward error of a trial solution, relative to each row


class UnstableError(ArithmeticError):
    """L − σM is singular, or its factors without pivoting are too inaccurate to be used."""


@dataclass(frozen=True, slots=True, eq=False)
class Factorisation:
    """L − σM in triangular factors.

    Parameters
    ----------
    shift : float
        σ, in the units of the eigenvalues.
    count_below : int
        The number of eigenvalues of (L, M) below σ.
    solve
        (L − σM)⁻¹ of the columns of an array (n, b).
    """

    shift: float
    count_below: int
    solve: Callable[[FloatArray], FloatArray]


def factorise(stiffness: SparseMatrix, mass: Mass, shift: float) -> Factorisation:
    """Factors of L − σM, and the number of eigenvalues below σ by Sylvester's law of inertia.

    Rows and columns are permuted alike and no pivot is sought off the diagonal. Then L − σM is
    T D Tᵀ with T triangular, and has as many negative eigenvalues as D has negative entries.
    Without pivoting the factors may become inaccurate; a trial solution tells.

    Raises
    ------
    UnstableError
        If a pivot vanishes or was sought off the diagonal, or the trial solution is inaccurate.
    InputError
        If there is not enough memory.
    """
    matrix = shifted(stiffness, mass, shift)
    try:
        factors = splu(
            matrix,
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=0.0,
            options={"SymmetricMode": True},
        )
    except RuntimeError as error:  # SuperLU: 'Factor is exactly singular'
        raise UnstableError(f"L − σM is singular at σ = {shift:.6g}.") from error
    except MemoryError as error:
        raise InputError(
            f"There is not enough memory to factorise a matrix of {matrix.shape[0]} vertices. "
            "Use a coarser mesh."
        ) from error
    pivots = factors.U.diagonal()
    if not np.array_equal(factors.perm_r, factors.perm_c) or not np.isfinite(pivots).all():
        raise UnstableError(f"L − σM was not factorised symmetrically at σ = {shift:.6g}.")
    trial = np.random.default_rng(0).standard_normal(matrix.shape[0])
    right = matrix @ trial
    solution = factors.solve(right)
    size = abs(matrix) @ abs(solution) + abs(right)
    defect = float(np.max(np.abs(matrix @ solution - right) / np.where(size > 0, size, 1.0)))
    if not defect < _STABLE:
        raise UnstableError(f"L − σM at σ = {shift:.6g} was solved with an error of {defect:.1e}.")
    return Factorisation(shift, int((pivots < 0).sum()), factors.solve)
