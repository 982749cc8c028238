import numpy as np
import pytest

from esd.common import InputError
from esd.learning.acnn import AnisotropicPatches
from esd.learning.gcnn import GeodesicPatches, geodesic_patches
from esd.learning.patches import convolution, patch_operator, patches_from_json
from esd.mesh.mesh import Mesh, PointCloud
from esd.mesh.shapes import grid
from esd.spectral.cache import Cache

PATCHES = GeodesicPatches()


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


@pytest.mark.parametrize("patches", [PATCHES, AnisotropicPatches()])
def test_patches_of_broken_meshes(blob, patches):
    loose = Mesh(np.concatenate([blob.vertices, [[9.0, 9, 9]]]), blob.faces)
    operator = patch_operator(patches, loose)
    np.testing.assert_allclose(operator.sum(axis=1), 1, atol=1e-6)
    assert (operator[-80:].indices == len(blob.vertices)).all()  # its own value
    collapsed = Mesh(blob.vertices, np.concatenate([blob.faces, [[0, 0, 1]]]))
    assert np.isfinite(patch_operator(patches, collapsed).data).all()
    with pytest.raises(InputError, match="Points have no faces, which patches need"):
        patch_operator(patches, PointCloud(blob.vertices))


def test_patches_are_those_of_the_surface_seen_from_outside(blob):
    operator = patch_operator(PATCHES, blob)
    assert abs(operator - geodesic_patches(blob, PATCHES)).max() < 1e-6
    inside_out = Mesh(blob.vertices, blob.faces[:, ::-1])
    assert abs(patch_operator(PATCHES, inside_out) - operator).max() < 1e-6
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
