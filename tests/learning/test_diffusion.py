import json
from dataclasses import replace

import numpy as np
import pytest

from esd.common import InputError
from esd.datasets.parts import part_of
from esd.descriptors.recipe import (
    part_recipe,
    recipe_spectrum,
    single_recipe,
    spectrum_descriptors,
)
from esd.learning.diffusion import DiffusionNetwork, diffusion_network, surface_of
from esd.learning.model import (
    Layer,
    Model,
    load_model,
    model_description,
    save_model,
    with_diffusion,
)
from esd.mesh.geometry import surface_area
from esd.mesh.mesh import Mesh
from esd.spectral.spectrum import spectrum


def random_weights(inputs, *, hidden=9, width=6, blocks=2, outputs=5):
    """Weights of a network, drawn at random, and times from 0.001 to 0.1."""
    generator = np.random.default_rng(0)
    layers = {"first": (hidden, inputs), "second": (width, hidden), "out": (outputs, width)}
    weights = {}
    for b in range(blocks):
        layers |= {f"{b}.first": (width, 3 * width), f"{b}.second": (width, width)}
        for name in ("real", "imaginary"):
            weights[f"{b}.{name}"] = generator.standard_normal((width, width)) / width**0.5
        weights[f"{b}.norm.weight"] = 1 + 0.1 * generator.standard_normal(width)
        weights[f"{b}.norm.bias"] = 0.1 * generator.standard_normal(width)
        weights[f"{b}.time"] = np.log(generator.uniform(1e-3, 0.1, width))
    for name, (rows, columns) in layers.items():
        weights[f"{name}.weight"] = generator.standard_normal((rows, columns)) / columns**0.5
        weights[f"{name}.bias"] = 0.1 * generator.standard_normal(rows)
    return {name: array.astype(np.float32) for name, array in weights.items()}


@pytest.fixture
def model():
    recipe = replace(part_recipe(), eigenpairs=60)
    network = diffusion_network(random_weights(recipe.width), inputs=recipe.width)
    return Model(
        "m",
        recipe,
        np.zeros(recipe.width),
        np.ones(recipe.width),
        limit=8.0,
        unit_length=True,
        diffusion=network,
        card={"data": "x"},
    )


def test_a_block_is_its_formula(blob):
    """One feature in and out, each of the three inputs of the block by itself."""
    one = np.ones((1, 1), dtype=np.float32)
    zero, none = np.zeros(1, dtype=np.float32), np.zeros((1, 1), dtype=np.float32)
    time, turn = 0.02, 0.7 - 1.1j
    weights = {f"{name}.weight": one for name in ("first", "second", "out", "0.second")}
    weights |= {f"{name}.bias": zero for name in ("first", "second", "out", "0.first", "0.second")}
    weights |= {"0.norm.weight": zero, "0.norm.bias": zero, "0.time": np.log(one[0] * time)}
    weights |= {"0.real": one * turn.real, "0.imaginary": one * turn.imag}
    found = spectrum(blob, 80)
    surface = surface_of(blob, found)
    values = np.random.default_rng(0).uniform(1, 2, (len(blob.vertices), 1))
    # with norm 0 · x + b every vertex has b, which diffuses to b, and whose gradient is zero
    for place in range(3):
        weights["0.first.weight"] = np.eye(3, dtype=np.float32)[[place]]
        weights["0.norm.bias"] = np.array([0.5], dtype=np.float32)
        network = diffusion_network(weights, inputs=1)
        np.testing.assert_allclose(
            network(values, surface) - values, 0 if place == 2 else 0.5, atol=1e-5
        )
    assert diffusion_network(weights, inputs=1).block_count == 1
    assert none.shape == surface.gradient[:1, :1].shape


def test_features_depend_on_neither_pose_nor_unit_nor_order_of_vertices(blob):
    values = np.random.default_rng(2).standard_normal((len(blob.vertices), 4))
    network = diffusion_network(random_weights(4), inputs=4)
    here = network(values, surface_of(blob, spectrum(blob, 80)))
    turn = np.linalg.qr(np.random.default_rng(0).standard_normal((3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    order = np.random.default_rng(1).permutation(len(blob.vertices))
    moved = Mesh(5 * blob.vertices[order] @ turn.T + 1, np.argsort(order)[blob.faces])
    there = network(values[order], surface_of(moved, spectrum(moved, 80)))
    np.testing.assert_allclose(there, here[order], atol=1e-3)  # 32 bits
    assert here.shape == (len(blob.vertices), 5)


def test_embeddings_have_unit_length(model, blob):
    embedded = model.embed_mesh(blob)
    assert embedded.shape == (len(blob.vertices), 5)
    np.testing.assert_allclose(np.linalg.norm(embedded, axis=1), 1, rtol=1e-5)


def test_mirror_images_embed_differently_by_gradients_alone(blob):
    found = spectrum(blob, 80)
    values = blob.vertices @ np.random.default_rng(0).standard_normal((3, 4))
    mirrored = Mesh(blob.vertices * [-1, 1, 1], blob.faces[:, ::-1])
    weights = random_weights(4)
    here, there = (
        diffusion_network(weights, inputs=4)(values, surface_of(mesh, found))
        for mesh in (blob, mirrored)
    )
    assert np.abs(here - there).max() > 0.01
    # without the part that turns, gradients are compared by their inner products
    weights |= {f"{b}.imaginary": np.zeros((6, 6), dtype=np.float32) for b in range(2)}
    here, there = (
        diffusion_network(weights, inputs=4)(values, surface_of(mesh, found))
        for mesh in (blob, mirrored)
    )
    np.testing.assert_allclose(here, there, atol=1e-4)


def test_a_surface_has_the_unit_of_its_spectrum(blob):
    part = part_of(blob, "cut of 20 %").mesh
    found = spectrum(part, 200)
    share = 0.8
    surface = surface_of(part, found.with_area(share))
    assert surface.spectrum.eigenvectors.shape[1] == 128
    # squares of the gradients of the three coordinates in that unit: 3 less that of the normal
    unit = np.sqrt(share / surface_area(part))
    slope = np.abs(surface.gradient @ (unit * part.vertices))
    assert abs(np.median((slope**2).sum(axis=1)) - 2) < 0.2  # less where edges are coarse
    assert surface_of(part, spectrum(part, 20)).spectrum.eigenvectors.shape[1] == 20


def test_networks_whose_weights_do_not_fit_are_refused():
    weights = random_weights(4)
    assert isinstance(diffusion_network(weights, inputs=4), DiffusionNetwork)
    with pytest.raises(InputError, match=r"lacks weights: 'out\.bias'"):
        diffusion_network({k: w for k, w in weights.items() if k != "out.bias"}, inputs=4)
    for wrong in (
        {k: w for k, w in weights.items() if k != "1.real"},
        weights | {"more": np.zeros(3, dtype=np.float32)},
        weights | {"0.norm.bias": np.zeros(5, dtype=np.float32)},
    ):
        with pytest.raises(InputError, match="do not fit each other"):
            diffusion_network(wrong, inputs=4)
    with pytest.raises(InputError, match="do not fit each other"):
        diffusion_network(weights, inputs=5)
    for value in (np.nan, np.inf):
        wrong = weights | {"0.time": np.full(6, value, dtype=np.float32)}
        with pytest.raises(InputError, match="not all finite"):
            diffusion_network(wrong, inputs=4)
    with pytest.raises(InputError, match="not all finite"):
        diffusion_network(weights | {"0.time": np.zeros(6, dtype=np.int64)}, inputs=4)


def test_models_come_back_as_they_were_saved(model, blob, tmp_path):
    save_model(model, tmp_path / "m")
    back = load_model(tmp_path / "m")
    np.testing.assert_array_equal(back.embed_mesh(blob), model.embed_mesh(blob))
    assert (back.recipe, back.unit_length, back.limit) == (model.recipe, True, 8.0)
    assert back.is_oriented
    assert not back.is_pointwise
    assert "- Network: 2 blocks of 6 features that diffuse over the surface, 5 outputs" in (
        model_description(model)
    )


def test_undefined_descriptors_embed_as_undefined_and_leave_others_finite(model, blob):
    mesh = Mesh(np.concatenate([blob.vertices, [[9.0, 9, 9]]]), blob.faces)
    embedded = model.embed_mesh(mesh)
    assert np.isnan(embedded[-1]).all()
    assert np.isfinite(embedded[:-1]).all()


def test_descriptors_without_their_surface_are_refused(model, blob):
    assert raises_nothing(model, blob)
    with pytest.raises(InputError, match="embeds all vertices of a shape together"):
        model.embed(np.zeros((3, model.recipe.width)))


def raises_nothing(model, mesh):
    operator = model.operator(mesh, recipe_spectrum(model.recipe, mesh))
    return model.embed(np.zeros((len(mesh.vertices), model.recipe.width)), operator) is not None


def test_saved_models_with_wrong_or_missing_weights_are_refused(model, tmp_path):
    from safetensors.numpy import load_file, save_file

    folder = tmp_path / "m"
    save_model(model, folder)
    weights = load_file(folder / "model.safetensors")
    for change, message in (
        ({"diffusion.out.bias": None}, "lacks weights: 'out.bias'"),
        ({"diffusion.1.norm.bias": None}, "do not fit each other"),
        ({"diffusion.0.time": np.full(6, np.nan, dtype=np.float32)}, "the training diverged"),
        ({"layer0.weight": np.zeros((2, 2), dtype=np.float32)}, "of different models"),
        ({"mean": np.zeros(3)}, "do not fit its recipe"),
    ):
        changed = {k: w for k, w in {**weights, **change}.items() if w is not None}
        save_file(changed, folder / "model.safetensors")
        with pytest.raises(InputError, match=message):
            load_model(folder)
    save_file(weights, folder / "model.safetensors")
    config = json.loads((folder / "config.json").read_text())
    config |= {"recipe": single_recipe("hks").to_json(), "layers": [100]}
    (folder / "config.json").write_text(json.dumps(config))
    with pytest.raises(InputError, match="do not fit each other"):
        load_model(folder)


def test_a_model_with_layers_and_a_network_embeds_by_both_side_by_side(blob, tmp_path):
    recipe = replace(single_recipe("hks"), eigenpairs=60)
    generator = np.random.default_rng(3)
    layer = Layer(
        generator.standard_normal((7, recipe.width)).astype("f4"), np.ones(7, dtype=np.float32)
    )
    values = spectrum_descriptors(recipe, blob, recipe_spectrum(recipe, blob))
    mean, deviation = values.mean(axis=0), values.std(axis=0)
    plain = Model("plain", recipe, mean, deviation, (layer,), limit=50.0, unit_length=True)
    network = diffusion_network(random_weights(recipe.width), inputs=recipe.width)
    surface = replace(
        plain, layers=(), mean=mean + 0.4 * deviation, deviation=1.3 * deviation, diffusion=network
    )
    both = with_diffusion(plain, surface)
    parts = [each.embed_mesh(blob) for each in (plain, surface)]
    found = both.embed_mesh(blob)
    np.testing.assert_allclose(found, np.hstack(parts) / 2**0.5, atol=2e-4)
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1, rtol=1e-5)
    save_model(both, tmp_path / "both")
    back = load_model(tmp_path / "both")
    np.testing.assert_array_equal(back.embed_mesh(blob), found)
    assert f"Layers: {recipe.width} – 7; network: 2 blocks" in model_description(back)
    assert not back.is_pointwise


def test_models_of_different_kinds_are_not_joined(model):
    default = load_model("oriented")
    plain = replace(default, diffusion=None)
    with pytest.raises(InputError, match="differ in their descriptors"):
        with_diffusion(plain, model)
    with pytest.raises(InputError, match="one must have layers alone"):
        with_diffusion(plain, plain)
    with pytest.raises(InputError, match="one must have layers alone"):
        with_diffusion(model, model)
