import numpy as np
import pytest

from esd.mesh.shapes import icosphere
from esd.spectral.bounds import error_bound
from esd.spectral.eigensolver import eigenpairs
from esd.spectral.laplacian import lumped_mass, stiffness


@pytest.fixture
def solved():
    mesh = icosphere(3)
    matrix, mass = stiffness(mesh), lumped_mass(mesh)
    found = eigenpairs(matrix, mass, 9)
    return matrix, mass, found.eigenvalues, found.eigenvectors.T.copy()


def test_the_bound_of_exact_eigenpairs_is_rounding(solved):
    assert error_bound(*solved, scale=10.0, tolerance=1e-12) < 1e-9


@pytest.mark.parametrize("shift", [1e-6, 1e-3, 1e-1])
def test_the_bound_covers_an_error_and_is_no_larger_than_needed(solved, shift):
    matrix, mass, values, rows = solved
    wrong = values.copy()
    wrong[4] += shift
    bound = error_bound(matrix, mass, wrong, rows, scale=10.0, tolerance=1e-12)
    # up to rounding of the eigenvalue, and the estimate of how far vectors are from orthonormal
    assert shift * (1 - 1e-6) <= bound < 1.5 * shift


def test_vectors_that_are_not_orthonormal_bound_nothing(solved):
    matrix, mass, values, rows = solved
    rows[1] = rows[2]
    assert error_bound(matrix, mass, values, rows, scale=10.0, tolerance=1e-12) == np.inf
