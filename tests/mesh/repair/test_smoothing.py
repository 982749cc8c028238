import numpy as np

from esd.datasets.perturb import geometric_noise
from esd.mesh.geometry import surface_area
from esd.mesh.mesh import Mesh
from esd.mesh.repair.repair import repair
from esd.mesh.repair.smoothing import smoothed
from esd.mesh.shapes import grid, icosphere

SPHERE = icosphere(4)


def roughness(mesh: Mesh) -> float:
    return float(np.linalg.norm(mesh.vertices, axis=1).std())


def test_noise_goes_and_the_shape_stays():
    assert abs(surface_area(smoothed(SPHERE)) / surface_area(SPHERE) - 1) < 0.002
    noisy = geometric_noise(SPHERE, 0.5).mesh
    assert surface_area(noisy) > 1.2 * surface_area(SPHERE)
    quiet = smoothed(noisy)
    assert roughness(quiet) < roughness(noisy) / 2
    assert abs(surface_area(quiet) / surface_area(SPHERE) - 1) < 0.03


def test_a_plane_stays_plane_and_lone_vertices_stay():
    mesh = grid(10, 10)
    lone = Mesh(np.concatenate([mesh.vertices, [[5.0, 6.0, 7.0]]]), mesh.faces)
    result = smoothed(lone)
    np.testing.assert_allclose(result.vertices[:-1, 2], 0, atol=1e-12)
    np.testing.assert_array_equal(result.vertices[-1], [5, 6, 7])


def test_a_mesh_is_smoothed_only_where_noise_is_found_and_asked_for():
    noisy = geometric_noise(SPHERE, 0.5).mesh
    assert "folded_edges" in repair(noisy, restore=True).done
    np.testing.assert_array_equal(repair(noisy).shape.vertices, noisy.vertices)
    assert roughness(repair(noisy, restore=True).shape) < roughness(noisy) / 2
    np.testing.assert_array_equal(repair(SPHERE, restore=True).shape.vertices, SPHERE.vertices)
