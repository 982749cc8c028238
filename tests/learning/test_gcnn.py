import numpy as np

from esd.learning.gcnn import GeodesicPatches, geodesic_patches
from esd.mesh.mesh import Mesh
from esd.mesh.shapes import grid, icosphere

PATCHES = GeodesicPatches()


def crooked_grid():
    """A flat square of area one, its inner vertices moved at random within the plane."""
    mesh = grid(31, 31)
    x, y, _ = mesh.vertices.T
    inner = (x > 0) & (x < 1) & (y > 0) & (y < 1)
    moves = np.random.default_rng(0).uniform(-0.3 / 30, 0.3 / 30, (len(x), 2))
    vertices = mesh.vertices.copy()
    vertices[inner, :2] += moves[inner]
    return Mesh(vertices, mesh.faces)


def polar_bins(vertices, middle, patches):
    """Weights (bins, n) in the plane, the first ray along y."""
    x, y = ((vertices - vertices[middle])[:, :2] / patches.radius).T
    distance, direction = np.hypot(x, y), np.arctan2(y, x) - np.pi / 2
    rows = []
    for ring in range(patches.rings):
        for ray in range(patches.rays):
            off = (distance - (ring + 0.5) / patches.rings) / (0.5 / patches.rings)
            turn = np.angle(np.exp(1j * (direction - 2 * np.pi * ray / patches.rays)))
            turn[middle] = 0
            weight = np.exp(-(off**2) / 2 - (turn / (np.pi / patches.rays)) ** 2 / 2)
            weight[distance > 1.1] = 0
            weight[weight < 0.01 * weight.max()] = 0
            rows.append(weight / weight.sum())
    return np.array(rows)


def test_patches_of_the_plane_are_polar_bins():
    mesh, patches = crooked_grid(), GeodesicPatches(radius=0.15)
    operator = geodesic_patches(mesh, patches)
    for middle in (15 * 31 + 15, 10 * 31 + 18):
        found = operator[middle * 80 : middle * 80 + 80].toarray()
        expected = polar_bins(mesh.vertices, middle, patches)
        np.testing.assert_allclose(found, expected, atol=1e-5)  # 32 bit


def test_coordinates_on_a_sphere_are_those_of_its_logarithm():
    mesh = icosphere(4)
    linear = np.concatenate([mesh.vertices, np.ones((len(mesh.vertices), 1))], axis=1)
    radius = PATCHES.radius * (4 * np.pi) ** 0.5
    operator = geodesic_patches(mesh, PATCHES)
    rng = np.random.default_rng(0)
    for middle in rng.integers(len(mesh.vertices), size=5):
        there = (operator[middle * 80 : middle * 80 + 80] @ linear)[:, :3].reshape(5, 16, 3)
        along = there @ mesh.vertices[middle]
        angle = np.arccos(np.minimum(along / np.linalg.norm(there, axis=2), 1))
        # vertices lie beside the rings, by up to half of what these are apart
        outer = angle[2:] / radius
        np.testing.assert_allclose(outer.mean(axis=1), [0.5, 0.7, 0.9], atol=0.1)
        flat = there[4] - along[4][:, None] * mesh.vertices[middle]
        turn = np.cross(flat, np.roll(flat, -1, axis=0)) @ mesh.vertices[middle]
        assert (turn > 0).all()  # counter-clockwise from outside


def test_rows_sum_to_one_and_need_no_units(blob):
    operator = geodesic_patches(blob, PATCHES)
    assert operator.shape == (80 * len(blob.vertices), len(blob.vertices))
    assert operator.dtype == np.float32
    assert operator.data.min() > 0
    np.testing.assert_allclose(operator.sum(axis=1), 1, atol=1e-6)
    larger = geodesic_patches(Mesh(1000 * blob.vertices + 5, blob.faces), PATCHES)
    assert abs(operator - larger).max() < 1e-4  # 32 bit, and directions of nearly equal paths
