"""How far approximate eigenvalues may be from the exact ones, read off their residuals."""

from __future__ import annotations

import numpy as np
from scipy import sparse

from esd.common import FloatArray
from esd.spectral.factorisation import UnstableError, factorise
from esd.spectral.laplacian import SparseMatrix
from esd.spectral.pencil import Mass, weighted

_COLUMNS = 64  # vectors treated at once where all of them would double the memory


def error_bound(
    stiffness: SparseMatrix,
    mass: Mass,
    values: FloatArray,
    rows: FloatArray,
    *,
    scale: float,
    tolerance: float,
) -> float:
    """Largest error of the values, counted with multiplicity.

    Bounds are tried in the order of their cost until one is within tolerance · scale: the
    residual's Frobenius norm, its spectral norm, and that in terms of (L − σM)⁻¹M, σ < 0, which
    rounding errors at slivers do not reach, but which takes one solution for each pair.
    """
    shortest = 1 - _non_orthonormality(mass, rows)
    if shortest <= 0:
        return np.inf
    residual = np.empty_like(rows)
    for start in range(0, len(rows), _COLUMNS):  # products with L copy what they are given
        part = slice(start, start + _COLUMNS)
        residual[part] = (stiffness @ rows[part].T).T
        residual[part] -= values[part, None] * weighted(mass, rows[part])
    if sparse.issparse(mass):
        dual = factorise(mass, mass, 0.0).solve(residual.T).T
        square = np.einsum("ij,ij->", residual, dual)
    else:
        square = np.einsum("ij,ij,j->", residual, residual, 1 / mass)
    bound = float(np.sqrt(square)) / shortest
    if bound <= tolerance * scale:
        return bound
    if not sparse.issparse(mass):
        dual = residual / mass
    bound = _spectral_norm(residual, dual) / shortest
    if bound <= tolerance * scale:
        return bound
    return min(bound, _inverse_bound(stiffness, mass, values, residual, -scale) / shortest)


def _inverse_bound(
    stiffness: SparseMatrix, mass: Mass, values: FloatArray, residual: FloatArray, shift: float
) -> float:
    """The bound by way of the eigenvalues θ = 1 / (λ − σ) of B = (L − σM)⁻¹M.

    With D = (L − σM)⁻¹R the residual of B is Bφ − θφ = −θD, and an error of ε in θ is one of
    ε (λ − σ)² / (1 − ε |λ − σ|) at most in λ.
    """
    try:
        inverse = factorise(stiffness, mass, shift)
    except UnstableError:
        return np.inf
    theta = 1 / (values - shift)
    for start in range(0, len(residual), _COLUMNS):
        part = slice(start, start + _COLUMNS)
        residual[part] = theta[part, None] * inverse.solve(residual[part].T).T
    epsilon = _spectral_norm(residual, weighted(mass, residual))
    farthest = float(values.max()) - shift
    return epsilon * farthest**2 / (1 - epsilon * farthest) if epsilon * farthest < 1 else np.inf


def _spectral_norm(rows: FloatArray, dual: FloatArray) -> float:
    """Norm of the matrix with these rows, given their duals under the inner product."""
    return float(np.sqrt(np.abs(np.linalg.eigvalsh(rows @ dual.T)).max()))


def _non_orthonormality(mass: Mass, rows: FloatArray) -> float:
    """Estimate from above of the norm of ΦᵀMΦ − I, by its action on random vectors."""
    probes = np.random.default_rng(0).standard_normal((8, len(rows)))
    images = weighted(mass, probes @ rows) @ rows.T - probes
    return 2 * float(np.sqrt(np.mean(np.sum(images**2, axis=1))))
