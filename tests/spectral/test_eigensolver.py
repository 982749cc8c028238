from __future__ import annotations

import logging

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy import linalg, sparse
from threadpoolctl import threadpool_limits

from esd.common import InputError
from esd.mesh.mesh import Mesh
from esd.mesh.shapes import grid, icosphere, torus
from esd.spectral import eigensolver
from esd.spectral.eigensolver import Eigenpairs, eigenpairs
from esd.spectral.factorisation import UnstableError, factorise
from esd.spectral.laplacian import lumped_mass, stiffness
from measures import consistent_mass


def solve(mesh: Mesh, k: int, **options) -> Eigenpairs:
    return eigenpairs(stiffness(mesh), lumped_mass(mesh), k, **options)


def dense(matrix, mass) -> np.ndarray:
    full = mass.toarray() if sparse.issparse(mass) else np.diag(mass)
    with threadpool_limits(1):  # more of them stall where other programs run
        return linalg.eigh(matrix.toarray(), full, eigvals_only=True)


def assert_orthonormal(result: Eigenpairs, mass) -> None:
    matrix = mass if sparse.issparse(mass) else sparse.diags_array(mass)
    gram = result.eigenvectors.T @ (matrix @ result.eigenvectors)
    # rounding errors of a sum over the vertices, and of two passes of orthogonalisation
    np.testing.assert_allclose(gram, np.eye(len(gram)), atol=1e-12)


def components_of(mesh: Mesh, count: int) -> tuple[sparse.csc_array, np.ndarray]:
    matrix = sparse.csc_array(sparse.block_diag([stiffness(mesh)] * count))
    return matrix, np.tile(lumped_mass(mesh), count)


def test_eigenvalues_of_the_sphere_are_l_times_l_plus_1():
    degree = np.repeat(np.arange(8), 2 * np.arange(8) + 1)
    exact = degree * (degree + 1.0)
    errors = []
    for subdivisions in (3, 4):
        result = solve(icosphere(subdivisions), len(exact))
        assert result.certified
        errors.append(np.max(np.abs(result.eigenvalues[1:] / exact[1:] - 1)))
    assert errors[0] / errors[1] == pytest.approx(4, rel=0.1)  # order 2 in the edge length


def test_eigenvalues_of_a_product_of_cycles():
    """The Kronecker sum of two cycles has the sums of their eigenvalues, most of them 8-fold."""
    n, k = 32, 120
    cycle = sparse.diags_array([2.0] * n) - sparse.eye_array(n, k=1) - sparse.eye_array(n, k=-1)
    cycle = sparse.lil_array(cycle)
    cycle[0, n - 1] = cycle[n - 1, 0] = -1
    matrix = sparse.kronsum(cycle, cycle, format="csc")
    one = 2 - 2 * np.cos(2 * np.pi * np.arange(n) / n)
    exact = np.sort(np.add.outer(one, one).ravel())[:k]
    result = eigenpairs(matrix, np.ones(n * n), k)
    assert result.certified and result.method == "block Lanczos"
    assert np.max(np.abs(result.eigenvalues - exact)) <= result.error_bound + 1e-14
    assert result.error_bound <= 1e-9 * exact[-1]


def test_a_diagonal_matrix_has_unit_eigenvectors():
    n, k = 2000, 60
    diagonal = np.random.default_rng(0).permutation(n).astype(float)
    mass = np.linspace(1, 2, n)
    result = eigenpairs(sparse.diags_array(diagonal * mass), mass, k)
    np.testing.assert_allclose(result.eigenvalues, np.arange(k), atol=1e-9 * k)
    expected = np.zeros((n, k))
    where = np.argsort(diagonal)[:k]
    expected[where, np.arange(k)] = 1 / np.sqrt(mass[where])
    np.testing.assert_allclose(result.eigenvectors, expected, atol=1e-7)


@pytest.mark.parametrize("k", [1, 2, 7, 40, 150, 300, 641, 642])
def test_every_k_agrees_with_a_dense_solution(k):
    mesh = icosphere(3)
    matrix, mass = stiffness(mesh), lumped_mass(mesh)
    result = eigenpairs(matrix, mass, k)
    expected = dense(matrix, mass)
    assert result.certified
    rounding = 1e-14 * expected[-1]  # of the dense solution
    assert np.max(np.abs(result.eigenvalues - expected[:k])) <= result.error_bound + rounding
    assert result.error_bound <= 1e-9 * expected[max(k - 1, 1)]
    assert_orthonormal(result, mass)


@pytest.mark.parametrize("mesh", [torus(40, 24), grid(31, 31)], ids=["torus", "grid"])
def test_the_eigenspaces_are_those_of_a_dense_solution(mesh):
    k = 90
    matrix, mass = stiffness(mesh), lumped_mass(mesh)
    values, vectors = linalg.eigh(matrix.toarray(), np.diag(mass), subset_by_index=(0, k + 4))
    widest = k - 5 + int(np.argmax(np.diff(values[k - 6 : k + 4])))  # do not cut a repeated one
    result = eigenpairs(matrix, mass, widest)
    np.testing.assert_allclose(result.eigenvalues, values[:widest], atol=1e-9 * values[k])
    overlap = result.eigenvectors.T @ (mass[:, None] * vectors[:, :widest])
    np.testing.assert_allclose(np.linalg.svd(overlap, compute_uv=False), 1, atol=1e-12)


def test_consistent_mass():
    mesh = grid(24, 24)
    matrix, mass = stiffness(mesh), consistent_mass(mesh)
    result = eigenpairs(matrix, mass, 40)
    assert result.certified and result.method == "block Lanczos"
    np.testing.assert_allclose(
        result.eigenvalues, dense(matrix, mass)[:40], atol=2e-9 * result.eigenvalues[-1]
    )
    assert_orthonormal(result, mass)


def test_consistent_mass_of_a_small_mesh():
    mesh = icosphere(1)
    matrix, mass = stiffness(mesh), consistent_mass(mesh)
    result = eigenpairs(matrix, mass, 42)
    assert result.certified and result.method == "dense"
    np.testing.assert_allclose(result.eigenvalues, dense(matrix, mass), atol=1e-11)
    assert_orthonormal(result, mass)


@pytest.mark.parametrize(("count", "k"), [(3, 30), (40, 60), (40, 20)])
def test_repeated_components_repeat_the_eigenvalues(count, k):
    matrix, mass = components_of(icosphere(1), count)
    single = dense(stiffness(icosphere(1)), lumped_mass(icosphere(1)))
    expected = np.sort(np.tile(single, count))[:k]
    result = eigenpairs(matrix, mass, k)
    assert result.certified
    np.testing.assert_allclose(result.eigenvalues, expected, atol=1e-8)
    assert_orthonormal(result, mass)


def test_more_copies_than_vectors_in_a_block():
    """A matrix in one piece, so that nothing tells beforehand how often its eigenvalues repeat."""
    n, copies = 600, 50
    diagonal = np.repeat(np.arange(n // copies), copies).astype(float)
    diagonal[-1] += 0.5
    mirror = np.ones(n) / np.sqrt(n)
    # A Householder reflection of the diagonal matrix: full, hence connected, the same spectrum.
    turned = np.diag(diagonal)
    turned -= 2 * np.outer(mirror, mirror @ turned)
    turned -= 2 * np.outer(turned @ mirror, mirror)
    result = eigenpairs((turned + turned.T) / 2, np.ones(n), 70)
    assert result.certified and result.method == "block Lanczos"
    np.testing.assert_allclose(result.eigenvalues, np.repeat([0.0, 1.0], [50, 20]), atol=1e-8)


def test_equal_eigenvalues_throughout():
    result = eigenpairs(sparse.eye_array(500), np.ones(500), 6)
    assert result.certified
    np.testing.assert_allclose(result.eigenvalues, 1, atol=1e-9)


def test_the_zero_matrix():
    result = eigenpairs(sparse.csc_array((500, 500)), np.ones(500), 6)
    assert result.certified
    np.testing.assert_allclose(result.eigenvalues, 0, atol=1e-9)


def test_a_shift_that_hits_an_eigenvalue_is_moved():
    # one eigenvalue at 4π · 6 / area, where the search for the shift starts
    n, k = 400, 10
    diagonal = np.arange(1.0, n + 1)
    diagonal[5] = 4 * np.pi * 6
    mass = np.full(n, 1 / n)
    with pytest.raises(UnstableError, match="singular"):
        factorise(sparse.diags_array(diagonal * mass).tocsc(), mass, diagonal[5])
    result = eigenpairs(sparse.diags_array(diagonal * mass), mass, k)
    assert result.certified
    np.testing.assert_allclose(result.eigenvalues, np.sort(diagonal)[:k], atol=1e-9)


@pytest.mark.parametrize("k", [30, 50, 90])
def test_a_shift_within_a_multiplet_costs_no_digits(k):
    """On a fine icosphere the copies of an eigenvalue differ little, and lie where σ belongs."""
    result = solve(icosphere(4), k)
    assert result.certified
    assert result.error_bound <= 1e-9 * result.eigenvalues[-1]


def test_slivers_are_no_matter_for_completeness():
    mesh = icosphere(3)
    vertices = mesh.vertices.copy()
    for a, b, _ in mesh.faces[::150]:
        vertices[a] = vertices[b] + 1e-7 * (vertices[a] - vertices[b])
    flat = Mesh(vertices, mesh.faces)
    matrix, mass = stiffness(flat), lumped_mass(flat)
    result = eigenpairs(matrix, mass, 50)
    assert result.certified
    expected = dense(matrix, mass)
    rounding = 1e-15 * expected[-1]  # of the dense solution, larger than ours
    assert np.max(np.abs(result.eigenvalues - expected[:50])) <= result.error_bound + rounding
    assert_orthonormal(result, mass)


@st.composite
def broken_meshes(draw) -> Mesh:
    """Components with and without boundary, with holes, noise and slivers."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    parts = draw(st.lists(st.sampled_from(["sphere", "torus", "grid"]), min_size=1, max_size=4))
    vertices, faces, offset = [], [], 0
    for number, part in enumerate(parts):
        mesh = {"sphere": icosphere(2), "torus": torus(14, 9), "grid": grid(12, 11)}[part]
        keep = rng.random(len(mesh.faces)) > draw(st.sampled_from([0.0, 0.1, 0.4]))
        noise = draw(st.sampled_from([0.0, 0.02, 0.1]))
        points = mesh.vertices + noise * rng.standard_normal(mesh.vertices.shape)
        for a, b, c in mesh.faces[rng.random(len(mesh.faces)) < draw(st.sampled_from([0, 0.02]))]:
            points[a] = (points[b] + points[c]) / 2 + draw(
                st.sampled_from([1e-3, 1e-6, 1e-9, 0.0])
            ) * (points[a] - points[b])
        vertices.append(points * 10.0 ** draw(st.integers(-1, 1)) + 5 * number)
        faces.append(mesh.faces[keep] + offset)
        offset += len(points)
    faces = np.concatenate(faces)
    used, index = np.unique(faces, return_inverse=True)
    return Mesh(np.concatenate(vertices)[used], index.reshape(-1, 3))


@settings(max_examples=40, deadline=None, suppress_health_check=list(HealthCheck))
@given(broken_meshes(), st.integers(1, 120))
def test_no_result_is_silently_wrong(caplog, mesh, k):
    caplog.clear()
    matrix, mass = stiffness(mesh), lumped_mass(mesh)
    k = min(k, len(mass))
    expected = dense(matrix, mass)
    result = eigenpairs(matrix, mass, k)
    assert result.certified or "not certified" in caplog.text.lower()
    assert_orthonormal(result, mass)
    if result.certified:
        rounding = 1e-14 * expected[-1]  # of the dense solution: relative to the largest eigenvalue
        assert np.max(np.abs(result.eigenvalues - expected[:k])) <= result.error_bound + rounding


def unstable(*args: object) -> None:
    raise UnstableError("no such luck")


def test_without_stable_factors_eigsh_is_used_and_said(monkeypatch, caplog):
    mesh = torus(24, 20)
    matrix, mass = stiffness(mesh), lumped_mass(mesh)
    monkeypatch.setattr(eigensolver, "factorise", unstable)
    with caplog.at_level(logging.WARNING):
        result = eigenpairs(matrix, mass, 20)
    assert "Fell back to eigsh, which is not certified: No shift was found" in caplog.text
    assert result.method == "eigsh" and not result.certified
    difference = np.abs(result.eigenvalues - dense(matrix, mass)[:20]).max()
    assert difference <= result.error_bound <= 1e-9 * result.eigenvalues[-1]
    assert_orthonormal(result, mass)


def test_the_result_depends_on_the_seed_alone():
    mesh = grid(60, 50)
    first, second = solve(mesh, 40, threads=1), solve(mesh, 40, threads=2)
    np.testing.assert_array_equal(first.eigenvalues, second.eigenvalues)
    np.testing.assert_array_equal(first.eigenvectors, second.eigenvectors)
    other = solve(mesh, 40, seed=1)
    assert np.any(other.eigenvectors != first.eigenvectors)
    np.testing.assert_allclose(
        other.eigenvalues, first.eigenvalues, atol=1e-9 * first.eigenvalues[-1]
    )


def test_eigenvalues_scale_with_the_inverse_of_the_mass():
    mesh = torus(30, 20)
    small = eigenpairs(stiffness(mesh), lumped_mass(mesh), 25)
    large = eigenpairs(stiffness(mesh), 1e8 * lumped_mass(mesh), 25)
    np.testing.assert_allclose(1e8 * large.eigenvalues, small.eigenvalues, atol=1e-8)


def test_the_largest_entry_is_positive():
    result = solve(grid(20, 15), 12)
    largest = np.argmax(np.abs(result.eigenvectors), axis=0)
    assert np.all(result.eigenvectors[largest, np.arange(12)] > 0)


@pytest.mark.parametrize("options", [{"tolerance": 0.0}, {"tolerance": np.nan}, {"threads": 0}])
def test_bad_options_are_refused(options):
    with pytest.raises(InputError, match=f"`{next(iter(options))}` must"):
        eigenpairs(stiffness(icosphere(1)), lumped_mass(icosphere(1)), 2, **options)


def test_a_ceiling_at_which_nothing_is_certain_is_moved_within_its_gap(monkeypatch, caplog):
    mesh = icosphere(4)
    shifts = []

    def unstable_twice(matrix, weights, shift):
        shifts.append(shift)
        if len(shifts) in (2, 3):  # the first is interior to the spectrum, the next are ceilings
            raise UnstableError("inaccurate")
        return factorise(matrix, weights, shift)

    monkeypatch.setattr(eigensolver, "factorise", unstable_twice)
    found = eigenpairs(stiffness(mesh), lumped_mass(mesh), 60)
    assert found.certified
    assert not caplog.text
    degree = np.floor(np.sqrt(np.arange(60)))
    np.testing.assert_allclose(found.eigenvalues, degree * (degree + 1), rtol=0.05, atol=1e-6)


def test_singular_matrices_are_refused_in_plain_words(monkeypatch, sphere):
    def singular(*_, **__):
        raise RuntimeError("Factor is exactly singular")

    monkeypatch.setattr("esd.spectral.factorisation.splu", singular)
    monkeypatch.setattr("esd.spectral.eigensolver.eigsh", singular)
    with pytest.raises(InputError, match="eigenvalues cannot be computed"):
        eigenpairs(stiffness(sphere), lumped_mass(sphere), 10)
