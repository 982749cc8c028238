import numpy as np
import pytest
from scipy import sparse

from esd.mesh.geometry import surface_area
from esd.mesh.mesh import Mesh
from esd.mesh.shapes import grid
from esd.spectral.laplacian import cotangents, laplacian, lumped_mass, stiffness
from esd.spectral.spectrum import spectrum
from measures import consistent_mass


@pytest.mark.parametrize("kind", ["cotangent", "robust"])
def test_operator_identities(blob, kind):
    matrix, mass = laplacian(blob, kind=kind)
    size = abs(matrix).max()
    assert abs(matrix - matrix.T).max() <= 1e-14 * size
    assert abs(matrix.sum(axis=0)).max() <= 1e-12 * size
    assert mass.sum() == pytest.approx(surface_area(blob), rel=1e-6)


def test_linear_functions_are_harmonic_inside_a_plane():
    mesh = grid(7, 6)
    inside = (np.abs(mesh.vertices[:, :2] - 0.5) < 0.49).all(axis=1)
    assert np.abs((stiffness(mesh) @ mesh.vertices)[inside]).max() < 1e-12


def test_dirichlet_energy_of_a_linear_function_is_the_area():
    mesh = grid(5, 5, width=2)
    x = mesh.vertices[:, 0]
    assert x @ stiffness(mesh) @ x == pytest.approx(2)
    assert consistent_mass(mesh).sum() == pytest.approx(2)
    assert x @ consistent_mass(mesh) @ x == pytest.approx(8 / 3)  # ∫ x² over the rectangle


def test_degenerate_faces_leave_the_operators_finite():
    flat = Mesh([[0, 0, 0], [1, 0, 0], [2, 0, 0], [0, 1, 0]], [[0, 1, 2], [0, 1, 3]])
    assert np.isfinite(stiffness(flat).toarray()).all()
    assert (lumped_mass(flat) > 0).all()


def test_faces_that_are_lines_leave_the_spectrum(blob, capped):
    assert np.abs(cotangents(capped)).max() < 2e4
    assert np.linalg.eigvalsh(stiffness(capped).toarray()).min() > -1e-9
    here, there = spectrum(blob, 40), spectrum(capped, 40)
    np.testing.assert_allclose(there.eigenvalues, here.eigenvalues, rtol=0.02, atol=1e-9)


def test_faces_that_are_points_have_no_stiffness():
    mesh = Mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2], [0, 0, 0]])
    assert (cotangents(mesh)[1] == 0).all()


def test_stiffness_is_sparse_and_in_columns(sphere):
    assert sparse.issparse(stiffness(sphere))
    assert stiffness(sphere).format == "csc"
