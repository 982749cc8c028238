from dataclasses import replace

import numpy as np
import pytest

from esd.common import InputError
from esd.learning.model import load_model, raw_model
from esd.matching.match import match
from esd.mesh.mesh import Mesh


def test_a_shape_matches_its_moved_and_renumbered_self(blob):
    from esd.descriptors.recipe import Descriptor, Recipe
    from esd.learning.model import Model

    order = np.random.default_rng(0).permutation(len(blob.vertices))
    rotation = np.linalg.qr(np.random.default_rng(1).standard_normal((3, 3)))[0]
    moved = Mesh(2 * blob.vertices[order] @ rotation, np.argsort(order)[blob.faces])
    recipe = Recipe((Descriptor("hks", 30, log=True),), eigenpairs=100)
    model = Model("hks", recipe, np.zeros(30), np.ones(30))
    result = match(blob, moved, model=model)
    assert (order[result.target_index] == np.arange(len(order))).mean() > 0.99
    assert result.confidence.min() > 0.9
    assert result.judgement.verdict == "good"


@pytest.mark.parametrize("refine", [False, True])
def test_one_to_one_maps_take_no_vertex_twice(blob, refine):
    from esd.descriptors.recipe import Descriptor, Recipe
    from esd.learning.model import Model

    recipe = Recipe((Descriptor("hks", 30, log=True),), eigenpairs=100)
    model = Model("hks", recipe, np.zeros(30), np.ones(30))
    noisy = Mesh(
        blob.vertices * [1, 1.1, 1.2] + 0.01 * np.sin(9 * blob.vertices[:, ::-1]), blob.faces
    )
    usual, single = (
        match(blob, noisy, model=model, refine=refine, one_to_one=each, candidates=["embedding"])
        for each in (False, True)
    )
    taken = single.target_index[single.is_matched()]
    assert len(taken) == len(np.unique(taken)) > len(np.unique(usual.target_index))
    assert np.isinf(single.distance[~single.is_matched()]).all()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"mirror": True}, "`mirror` must be one of auto, yes, no; got True"),
        ({"scale": "x"}, "`scale` must be one of auto, same, free; got x"),
    ],
)
def test_options_that_are_none_are_refused(blob, options, message):
    with pytest.raises(InputError, match=message):
        match(blob, blob, **options)


def test_too_small_meshes_are_refused_by_models():
    tetrahedron = Mesh(np.eye(4, 3), [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])
    with pytest.raises(InputError, match="300 eigenpairs were asked for; this mesh of 4"):
        match(tetrahedron, tetrahedron, model=raw_model("hks"))


@pytest.mark.parametrize("device", ["cpu:0", "cuda"])  # torch on the processor, and on a GPU
def test_torch_finds_the_map_that_numpy_finds(blob, device):
    torch = pytest.importorskip("torch", reason="other devices need the extra `train`")
    if device == "cuda" and not torch.cuda.is_available():
        pytest.skip("there is no GPU")
    here = load_model("default")
    there = replace(here, device=device)
    values = np.random.default_rng(0).normal(size=(50, here.recipe.width))
    layers = [replace(each, diffusion=None).embed(values) for each in (here, there)]
    np.testing.assert_allclose(layers[1], layers[0], rtol=1e-9, atol=1e-9)
    other = Mesh(blob.vertices * [1, 1.1, 1], blob.faces)
    a, b = (match(blob, other, model=model) for model in (here, there))
    np.testing.assert_array_equal(a.target_index, b.target_index)
    np.testing.assert_allclose(a.distance, b.distance, rtol=1e-5, atol=1e-6)
