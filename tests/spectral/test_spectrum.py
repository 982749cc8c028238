import numpy as np
import pytest

from esd.common import InputError
from esd.mesh.geometry import surface_area
from esd.mesh.io.meshes import write_mesh
from esd.mesh.mesh import Mesh
from esd.mesh.shapes import icosphere, torus
from esd.spectral.spectrum import save_spectrum, spectrum


def test_sphere_eigenvalues_converge_at_order_two():
    exact = np.repeat([l * (l + 1) for l in range(5)], [2 * l + 1 for l in range(5)])[1:]  # noqa: E741
    errors = []
    for subdivisions in (3, 4):
        mesh = icosphere(subdivisions)
        values = spectrum(mesh, 25).with_area(surface_area(mesh)).eigenvalues[1:]
        errors.append(np.abs(values - exact) / exact)
    assert np.log2(errors[0].mean() / errors[1].mean()) >= 1.9


def test_eigenvectors_are_orthonormal_and_scaling_laws_hold(blob):
    found = spectrum(blob, 30)
    gram = found.eigenvectors.T @ (found.mass[:, None] * found.eigenvectors)
    np.testing.assert_allclose(gram, np.eye(30), atol=1e-9)  # the solver's tolerance
    assert found.area == pytest.approx(1)
    scaled = spectrum(Mesh(7 * blob.vertices, blob.faces), 30)
    np.testing.assert_allclose(scaled.eigenvalues, found.eigenvalues, rtol=1e-8, atol=1e-8)
    double = found.with_area(2.0)
    assert double.area == pytest.approx(2)
    np.testing.assert_allclose(double.eigenvalues, found.eigenvalues / 2)
    gram = double.eigenvectors.T @ (double.mass[:, None] * double.eigenvectors)
    np.testing.assert_allclose(gram, np.eye(30), atol=1e-9)


def test_each_component_has_a_zero_mode_and_lone_vertices_are_zero():
    mesh = icosphere(2)
    count = len(mesh.vertices)
    two = Mesh(
        np.concatenate([mesh.vertices, 0.7 * mesh.vertices, [[5, 5, 5]]]),
        np.concatenate([mesh.faces, mesh.faces + count]),
    )
    found = spectrum(two, 12)
    assert found.zero_modes == 2
    assert (found.eigenvalues[:2] == 0).all()
    assert found.eigenvalues[2] > 1
    assert found.mass[-1] == 0
    assert (found.eigenvectors[-1] == 0).all()
    assert found.nonzero()[1].shape == (2 * count + 1, 10)


def test_impossible_numbers_of_eigenpairs_are_refused():
    mesh = icosphere(0)
    with pytest.raises(InputError, match=r"13 eigenpairs .* 12 connected vertices .* 2 to 12"):
        spectrum(mesh, 13)
    with pytest.raises(InputError, match="allows 2 to 12"):
        spectrum(mesh, 1)
    with pytest.raises(InputError, match="`k` must be from 2 to 5"):
        spectrum(mesh, 5).truncated(6)
    assert spectrum(mesh, 5).truncated(3).eigenvectors.shape == (12, 3)
    point = Mesh(np.ones((3, 3)), [[0, 1, 2]])
    with pytest.raises(InputError, match="no area"):
        spectrum(point, 3)


def test_saved_spectra_hold_every_array(tmp_path, sphere):
    found = spectrum(sphere, 10)
    save_spectrum(found, tmp_path / "s.npz")
    with np.load(tmp_path / "s.npz", allow_pickle=False) as file:
        np.testing.assert_array_equal(file["eigenvectors"], found.eigenvectors)
        assert file["zero_modes"] == 1
    with pytest.raises(InputError, match=r"\.npz"):
        save_spectrum(found, tmp_path / "s.txt")


def test_spectra_are_of_whatever_is_a_mesh(tmp_path):
    mesh = torus(12, 8)
    write_mesh(mesh, tmp_path / "m.off")
    expected = spectrum(mesh, 10).eigenvalues
    for given in ((mesh.vertices, mesh.faces), tmp_path / "m.off", str(tmp_path / "m.off")):
        np.testing.assert_array_equal(spectrum(given, 10).eigenvalues, expected)
    with pytest.raises(InputError, match="Expected a mesh"):
        spectrum(3)


def test_a_wrong_laplacian_is_refused(sphere):
    with pytest.raises(InputError, match="must be 'cotangent' or 'robust'; got 'wrong'"):
        spectrum(sphere, 10, kind="wrong")
