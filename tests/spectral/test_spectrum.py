from pathlib import Path

import numpy as np
import pytest
from scipy import sparse

from esd.common import InputError
from esd.mesh.geometry import surface_area
from esd.mesh.mesh import Mesh
from esd.mesh.shapes import grid, icosphere
from esd.spectral.cache import Cache, content_key, default_cache
from esd.spectral.laplacian import cotangents, laplacian, lumped_mass, stiffness
from esd.spectral.spectrum import save_spectrum, spectrum
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


def test_cache_returns_what_it_keeps_and_only_for_equal_content(tmp_path, sphere, blob):
    cache = Cache(tmp_path / "c", 10**9)
    first = spectrum(sphere, 10, cache=cache)
    again = spectrum(sphere, 10, cache=cache)
    np.testing.assert_array_equal(first.eigenvectors, again.eigenvectors)
    assert len(cache.entries()) == 1
    spectrum(blob, 10, cache=cache)
    spectrum(sphere, 11, cache=cache)
    assert len(cache.entries()) == 3
    cache.clear()
    assert cache.entries() == []


def test_damaged_entries_are_computed_again(tmp_path, sphere, caplog):
    cache = Cache(tmp_path / "c", 10**9)
    first = spectrum(sphere, 10, cache=cache)
    [(path, size)] = cache.entries()
    path.write_bytes(path.read_bytes()[: size // 2])
    again = spectrum(sphere, 10, cache=cache)
    np.testing.assert_array_equal(first.eigenvalues, again.eigenvalues)
    assert "damaged" in caplog.text


@pytest.mark.parametrize(
    "altered",
    [
        lambda arrays: {"x": arrays["mass"]},
        lambda arrays: {name: array.astype(str) for name, array in arrays.items()},
        lambda arrays: {**arrays, "eigenvalues": 2 * arrays["eigenvalues"]},
        lambda arrays: {k: v for k, v in arrays.items() if k != "digest"},
    ],
    ids=["names", "types", "content", "no digest"],
)
def test_altered_entries_are_computed_again(tmp_path, sphere, caplog, altered):
    cache = Cache(tmp_path / "c", 10**9)
    first = spectrum(sphere, 10, cache=cache)
    [(path, _)] = cache.entries()
    with np.load(path) as archive:
        arrays = dict(archive)
    np.savez(path, **altered(arrays))
    again = spectrum(sphere, 10, cache=cache)
    np.testing.assert_array_equal(first.eigenvalues, again.eigenvalues)
    assert "not those that were stored" in caplog.text
    assert spectrum(sphere, 10, cache=cache).eigenvalues.dtype == float


def test_a_wrong_laplacian_is_refused(sphere):
    with pytest.raises(InputError, match="must be 'cotangent' or 'robust'; got 'wrong'"):
        spectrum(sphere, 10, kind="wrong")


def test_cache_forgets_the_oldest_beyond_its_limit(tmp_path):
    cache = Cache(tmp_path / "c", 5000)
    for i in range(4):
        cache.store(content_key("x", np.array([i])), {"a": np.zeros(300)})
    assert 1 <= len(cache.entries()) < 4
    assert cache.load(content_key("x", np.array([3]))) is not None
    assert cache.load(content_key("x", np.array([0]))) is None


def test_unwritable_cache_costs_only_a_warning(tmp_path, sphere, caplog):
    (tmp_path / "file").write_text("")
    cache = Cache(tmp_path / "file", 10**9)
    assert len(spectrum(sphere, 10, cache=cache).eigenvalues) == 10
    assert "cannot be written" in caplog.text


def test_environment_chooses_the_cache(monkeypatch, tmp_path):
    monkeypatch.setenv("ESD_CACHE", "off")
    assert default_cache() is None
    monkeypatch.setenv("ESD_CACHE", str(tmp_path))
    monkeypatch.setenv("ESD_CACHE_LIMIT", "0.5")
    assert default_cache() == Cache(tmp_path, 500_000_000)
    for limit in ("big", "inf", "nan", "-1"):
        monkeypatch.setenv("ESD_CACHE_LIMIT", limit)
        with pytest.raises(InputError, match="number of gigabytes"):
            default_cache()


def test_who_has_no_home_folder_has_no_cache(monkeypatch, caplog):
    def homeless(name: str) -> Path:
        raise RuntimeError("could not determine the home directory")

    monkeypatch.delenv("ESD_CACHE")
    monkeypatch.setattr("platformdirs.user_cache_path", homeless)
    assert default_cache() is None
    assert "name a folder in ESD_CACHE" in caplog.text


def test_stiffness_is_sparse_and_in_columns(sphere):
    assert sparse.issparse(stiffness(sphere))
    assert stiffness(sphere).format == "csc"
