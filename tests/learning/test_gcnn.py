import numpy as np
import pytest

from esd.common import InputError
from esd.learning.gcnn import GeodesicPatches, geodesic_patches
from esd.learning.patches import convolution, patch_operator, patches_from_json
from esd.mesh.mesh import Mesh, PointCloud
from esd.mesh.shapes import grid, icosphere
from esd.spectral.cache import Cache

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


def test_turning_the_first_ray_permutes_rays_and_leaves_the_layer_as_it_is(blob):
    rng = np.random.default_rng(0)
    values = rng.standard_normal((len(blob.vertices), 3))
    weight = rng.standard_normal((4, 5, 16, 3)).astype(np.float32)
    operator = geodesic_patches(blob, PATCHES)
    rows = np.arange(operator.shape[0]).reshape(-1, 5, 16)
    turned = operator[np.roll(rows, 3, axis=2).ravel()]
    result = convolution(operator, values, weight, turned=True)
    assert result.shape == (len(blob.vertices), 4)
    np.testing.assert_allclose(convolution(turned, values, weight, turned=True), result, atol=1e-5)
    once = convolution(operator, values, weight, turned=False)
    assert (once <= result + 1e-9).all()
    assert not np.allclose(convolution(turned, values, weight, turned=False), once)
    # by the definition, at one vertex
    patch = (operator[80 * 7 : 80 * 8] @ values).reshape(5, 16, 3)
    by_hand = [(np.roll(weight, turn, axis=2) * patch).sum(axis=(1, 2, 3)) for turn in range(16)]
    np.testing.assert_allclose(result[7], np.max(by_hand, axis=0), rtol=1e-5)


def test_patches_of_broken_meshes(blob):
    loose = Mesh(np.concatenate([blob.vertices, [[9.0, 9, 9]]]), blob.faces)
    operator = patch_operator(PATCHES, loose)
    np.testing.assert_allclose(operator.sum(axis=1), 1, atol=1e-6)
    assert (operator[-80:].indices == len(blob.vertices)).all()  # its own value
    assert abs(operator[:-80, :-1] - geodesic_patches(blob, PATCHES)).max() < 1e-6
    collapsed = Mesh(blob.vertices, np.concatenate([blob.faces, [[0, 0, 1]]]))
    assert np.isfinite(patch_operator(PATCHES, collapsed).data).all()
    inside_out = Mesh(blob.vertices, blob.faces[:, ::-1])
    assert abs(patch_operator(PATCHES, inside_out) - operator[:-80, :-1]).max() < 1e-6
    with pytest.raises(InputError, match="Points have no faces, which patches need"):
        patch_operator(PATCHES, PointCloud(blob.vertices))
    strip = grid(31, 4)
    ends = np.arange(4), 120 + np.arange(4)[::-1]
    index = np.arange(124)
    index[ends[1]] = ends[0]
    moebius = Mesh(strip.vertices, index[strip.faces])
    with pytest.raises(InputError, match="mesh is inconsistently oriented"):
        patch_operator(PATCHES, moebius)
    with pytest.raises(InputError, match="no patches of a surface: 'square'"):
        patches_from_json({"kind": "square"})


def test_patches_are_cached_by_content(blob, tmp_path):
    cache = Cache(tmp_path, 10**9)
    first = patch_operator(PATCHES, blob, cache=cache)
    assert len(cache.entries()) == 1
    again = patch_operator(PATCHES, blob, cache=cache)
    assert (first != again).nnz == 0
    patch_operator(GeodesicPatches(radius=0.1), blob, cache=cache)
    assert len(cache.entries()) == 2
