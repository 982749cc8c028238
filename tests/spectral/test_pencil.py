from __future__ import annotations

import numpy as np
import pytest
from scipy import sparse

from esd.common import InputError
from esd.mesh.shapes import icosphere
from esd.spectral.eigensolver import eigenpairs
from esd.spectral.laplacian import lumped_mass, stiffness
from esd.spectral.pencil import checked_pencil, shifted, weighted
from measures import consistent_mass


def test_a_diagonal_sparse_mass_is_a_lumped_one():
    mesh = icosphere(2)
    matrix, mass = stiffness(mesh), lumped_mass(mesh)
    lumped = eigenpairs(matrix, mass, 10)
    result = eigenpairs(matrix, sparse.diags_array(mass), 10)
    np.testing.assert_array_equal(result.eigenvectors, lumped.eigenvectors)


LAPLACIAN = stiffness(icosphere(1))


MASS = lumped_mass(icosphere(1))


def with_entry(row: int, column: int, value: float) -> sparse.csc_array:
    matrix = LAPLACIAN.toarray()
    matrix[row, column] = value
    return sparse.csc_array(matrix)


@pytest.mark.parametrize(
    ("matrix", "mass", "k", "message"),
    [
        (LAPLACIAN, MASS, 0, "`k` must be from 1 to 42"),
        (LAPLACIAN, MASS, 43, "`k` must be from 1 to 42"),
        (LAPLACIAN, MASS, 2.5, "`k` must be an integer; got 2.5"),
        (LAPLACIAN[:, :9], MASS, 2, "`stiffness` must be a matrix"),
        (np.ones(42), MASS, 2, "`stiffness` must be a matrix"),
        (with_entry(0, 0, np.nan), MASS, 2, "`stiffness` must be finite; 1 are not"),
        (with_entry(0, 1, 7.0), MASS, 2, "`stiffness` must be symmetric.*pass L and M"),
        (-LAPLACIAN, MASS, 2, "diagonal is negative.*pass −Δ"),
        (LAPLACIAN, MASS[:9], 2, r"`mass` must be \(n,\).*n = 42; got \(9,\)"),
        (LAPLACIAN, 0 * MASS, 2, "`mass` must be positive; that of vertex 0 is 0.0"),
        (LAPLACIAN, np.where(MASS > 0, np.inf, 0), 2, "`mass` must be positive; .* is inf"),
        (LAPLACIAN, LAPLACIAN - 0.01 * sparse.eye_array(42), 2, "`mass` must be positive definite"),
        (LAPLACIAN, -consistent_mass(icosphere(1)), 2, "`mass` must be positive"),
        (LAPLACIAN, LAPLACIAN[:9, :9], 2, r"`mass` must be \(n,\) or \(n, n\)"),
    ],
)
def test_bad_input_is_refused(matrix, mass, k, message):
    with pytest.raises(InputError, match=message):
        eigenpairs(matrix, mass, k)


def test_a_shift_and_a_product_are_those_of_either_mass():
    consistent = consistent_mass(icosphere(1))
    rows = np.random.default_rng(0).standard_normal((3, 42))
    for mass, full in ((MASS, np.diag(MASS)), (consistent, consistent.toarray())):
        np.testing.assert_allclose(
            shifted(LAPLACIAN, mass, 2.5).toarray(), LAPLACIAN.toarray() - 2.5 * full
        )
        np.testing.assert_allclose(weighted(mass, rows), rows @ full)


def test_checked_matrices_are_in_columns_and_a_diagonal_mass_is_an_array():
    matrix, mass = checked_pencil(LAPLACIAN.toarray(), sparse.diags_array(MASS))
    assert matrix.format == "csc"
    np.testing.assert_array_equal(matrix.toarray(), LAPLACIAN.toarray())
    np.testing.assert_array_equal(mass, MASS)
    _, consistent = checked_pencil(LAPLACIAN, consistent_mass(icosphere(1)))
    assert sparse.issparse(consistent)
