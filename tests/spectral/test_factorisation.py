from __future__ import annotations

import numpy as np
import pytest
from scipy import linalg, sparse
from threadpoolctl import threadpool_limits

from esd.common import InputError
from esd.mesh.shapes import icosphere
from esd.spectral.factorisation import UnstableError, factorise
from esd.spectral.laplacian import lumped_mass, stiffness


def dense(matrix, mass) -> np.ndarray:
    full = mass.toarray() if sparse.issparse(mass) else np.diag(mass)
    with threadpool_limits(1):  # more of them stall where other programs run
        return linalg.eigh(matrix.toarray(), full, eigvals_only=True)


def test_pivots_off_the_diagonal_are_refused():
    swap = sparse.csc_array(np.array([[0.0, 1.0], [1.0, 0.0]]))
    with pytest.raises(UnstableError, match=r"singular|symmetrically"):
        factorise(swap, np.ones(2), 0.0)


def test_growing_pivots_are_refused():
    tiny = sparse.csc_array(np.array([[1e-20, 1.0], [1.0, 1e-20]]))
    with pytest.raises(UnstableError, match="with an error of"):
        factorise(tiny, np.ones(2), 0.0)


def test_the_inertia_counts_the_eigenvalues_below_a_shift():
    mesh = icosphere(2)
    matrix, mass = stiffness(mesh), lumped_mass(mesh)
    expected = dense(matrix, mass)
    for shift in (-1.0, 1.0, 10.0, 50.0, 200.0):
        assert factorise(matrix, mass, shift).count_below == int((expected < shift).sum())


def test_too_little_memory_is_said(monkeypatch, sphere):
    def out_of_memory(*_, **__):
        raise MemoryError

    monkeypatch.setattr("esd.spectral.factorisation.splu", out_of_memory)
    with pytest.raises(InputError, match="not enough memory to factorise"):
        factorise(stiffness(sphere), lumped_mass(sphere), 1.0)
