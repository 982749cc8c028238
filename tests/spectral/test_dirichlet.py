import numpy as np
import pytest
from scipy.spatial import Delaunay
from scipy.special import jn_zeros

from esd.common import InputError
from esd.mesh.geometry import surface_area
from esd.mesh.mesh import Mesh
from esd.mesh.shapes import grid
from esd.mesh.topology import boundary_edges
from esd.spectral.cache import Cache
from esd.spectral.dirichlet import dirichlet_spectrum
from esd.spectral.spectrum import spectrum


def disc(rings: int) -> Mesh:
    """The unit disc, of so many rings of points around its centre."""
    points = [np.zeros((1, 2))]
    for ring in range(1, rings + 1):
        angle = 2 * np.pi * np.arange(6 * ring) / (6 * ring)
        points.append(ring / rings * np.stack([np.cos(angle), np.sin(angle)], axis=1))
    flat = np.concatenate(points)
    return Mesh(np.pad(flat, ((0, 0), (0, 1))), Delaunay(flat).simplices.astype(np.int64))


def test_eigenvalues_of_a_disc_are_squares_of_zeros_of_bessel_functions_to_order_two():
    # those of J_m once for m = 0, else twice: for the cosine and the sine
    zeros = [np.repeat(jn_zeros(m, 4), 1 + (m > 0)) for m in range(9)]
    exact = np.sort(np.concatenate(zeros))[:15] ** 2
    errors = []
    for rings in (10, 20):
        mesh = disc(rings)
        found = dirichlet_spectrum(mesh, 15).with_area(surface_area(mesh))
        errors.append(np.abs(found.eigenvalues - exact) / exact)
    assert errors[1].max() < 0.02
    assert np.log2(errors[0].mean() / errors[1].mean()) >= 1.9


def test_eigenvectors_vanish_on_the_boundary_and_are_orthonormal():
    mesh = grid(20, 15)
    found = dirichlet_spectrum(mesh, 30)
    assert found.area == pytest.approx(1)
    assert found.zero_modes == 0
    assert (found.eigenvectors[np.unique(boundary_edges(mesh))] == 0).all()
    gram = found.eigenvectors.T @ (found.mass[:, None] * found.eigenvectors)
    np.testing.assert_allclose(gram, np.eye(30), atol=1e-9)  # the solver's tolerance
    # smaller spaces of functions have larger minima (Courant)
    assert (found.eigenvalues > spectrum(mesh, 30).eigenvalues).all()


def test_there_are_no_more_eigenpairs_than_vertices_inside():
    assert dirichlet_spectrum(grid(5, 4), 30).eigenvectors.shape == (20, 6)


def test_a_spectrum_is_found_in_the_cache(tmp_path):
    cache = Cache(tmp_path, 2**20)
    first, second = (dirichlet_spectrum(grid(6, 5), 5, cache=cache) for _ in range(2))
    assert len(list(tmp_path.iterdir())) == 1
    np.testing.assert_array_equal(first.eigenvectors, second.eigenvectors)
    np.testing.assert_array_equal(first.mass, second.mass)


def test_meshes_without_boundary_or_without_inside_are_refused(sphere):
    with pytest.raises(InputError, match=r"need a boundary, .* 0 vertices on its boundary and 642"):
        dirichlet_spectrum(sphere, 5)
    with pytest.raises(InputError, match="3 vertices on its boundary and 0 inside"):
        dirichlet_spectrum(Mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]]), 5)
