"""Eigenpairs of the generalised problem L φ = λ M φ."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import linalg, sparse
from scipy.sparse.linalg import eigsh

from esd.common import FloatArray, InputError


@dataclass(frozen=True, slots=True, eq=False)
class Eigenpairs:
    """Smallest eigenvalues (k,), ascending, and mass-orthonormal eigenvectors (n, k)."""

    eigenvalues: FloatArray
    eigenvectors: FloatArray


def eigenpairs(stiffness: Any, mass: FloatArray, k: int) -> Eigenpairs:
    """The k smallest eigenpairs for a symmetric positive semidefinite stiffness and lumped mass."""
    size = stiffness.shape[0]
    if not 1 <= k <= size:
        raise InputError(f"`k` must be from 1 to {size}, the number of vertices; got {k}.")
    root = 1 / np.sqrt(mass)
    scaling = sparse.diags_array(root)
    matrix = (scaling @ stiffness @ scaling).tocsc()
    if size <= 2 * k + 20:
        values, vectors = linalg.eigh(matrix.toarray(), subset_by_index=(0, k - 1))
    else:
        shift = -1e-6 * abs(matrix.diagonal()).mean()
        start = np.random.default_rng(0).standard_normal(size)
        values, vectors = eigsh(matrix, k, sigma=shift, v0=start, ncv=min(size, int(1.5 * k) + 20))
        order = np.argsort(values)
        values, vectors = values[order], vectors[:, order]
    vectors = root[:, None] * vectors
    largest = np.abs(vectors).argmax(axis=0)
    return Eigenpairs(values, vectors * np.sign(vectors[largest, np.arange(k)]))
