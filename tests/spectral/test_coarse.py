import numpy as np
import pytest

from esd.common import InputError
from esd.mesh.geometry import surface_area
from esd.mesh.mesh import Mesh, PointCloud
from esd.mesh.shapes import icosphere
from esd.spectral.cache import Cache
from esd.spectral.coarse import coarse_copy, coarse_spectrum
from esd.spectral.spectrum import spectrum

SPHERE = icosphere(5)
EXACT = np.repeat(np.arange(6), 2 * np.arange(6) + 1) * np.repeat(np.arange(1, 7), range(1, 12, 2))


def with_a_loose_vertex(mesh):
    return Mesh(np.vstack([[[9, 9, 9]], mesh.vertices]), mesh.faces + 1)


def test_dense_vertices_lie_on_the_copy():
    copy = coarse_copy(with_a_loose_vertex(SPHERE), 1000)
    assert abs(len(copy.mesh.vertices) - 1000) < 50
    assert copy.points.face[0] == -1
    places = copy.carried(copy.mesh.vertices)
    assert np.isnan(places[0]).all()
    # triangles of side 0.12 are 0.12² / 6 = 0.0024 below the sphere in the middle; some are larger
    assert np.linalg.norm(places[1:] - SPHERE.vertices, axis=1).max() < 0.008


def test_a_mesh_of_few_vertices_is_its_own_copy():
    copy = coarse_copy(SPHERE, 20_000)
    assert copy.mesh is SPHERE
    np.testing.assert_allclose(copy.carried(SPHERE.vertices), SPHERE.vertices, atol=1e-12)
    small = icosphere(2)
    own = coarse_spectrum(small, 10, vertex_count=20_000)
    np.testing.assert_array_equal(own.eigenvalues, spectrum(small, 10).eigenvalues)


def test_eigenvalues_of_copies_converge_and_eigenvectors_are_orthonormal():
    mesh = with_a_loose_vertex(SPHERE)
    worst = []
    for count in (500, 2000):
        found = coarse_spectrum(mesh, len(EXACT), vertex_count=count)
        values = found.eigenvalues / (4 * np.pi)
        worst.append(np.abs(values[1:] / EXACT[1:] - 1).max())
        gram = found.eigenvectors.T @ (found.mass[:, None] * found.eigenvectors)
        np.testing.assert_allclose(gram, np.eye(len(EXACT)), atol=1e-12)
        assert not found.eigenvectors[0].any()
        assert found.mass[0] == 0
        # functions of one degree span what x, y, z span
        span = found.eigenvectors[1:, 1:4]
        rest = SPHERE.vertices - span @ (span.T @ (found.mass[1:, None] * SPHERE.vertices))
        assert np.abs(rest).max() < (0.012 if count == 500 else 0.003)  # twice what it is
    assert worst[0] < 0.1  # of second order in the edges, λ h² / 12 = 0.06 for the largest λ
    assert 3 < worst[0] / worst[1] < 5  # at four times as many vertices


def test_copies_are_kept_in_the_cache(tmp_path):
    cache = Cache(tmp_path, 10**9)
    first = coarse_copy(SPHERE, 600, cache=cache)
    assert len(cache.entries()) == 1
    again = coarse_copy(SPHERE, 600, cache=cache)
    np.testing.assert_array_equal(first.mesh.faces, again.mesh.faces)
    assert surface_area(again.mesh) == surface_area(first.mesh)


def test_points_have_no_copy():
    with pytest.raises(InputError, match="Points without faces have no coarse copy"):
        coarse_copy(PointCloud(SPHERE.vertices), 100)
