import json
import re
from dataclasses import replace

import numpy as np
import pytest

from esd.common import InputError
from esd.descriptors.recipe import single_recipe
from esd.learning.model import (
    Layer,
    Model,
    load_model,
    model_description,
    raw_model,
    save_model,
)


@pytest.fixture
def model():
    generator = np.random.default_rng(0)
    layer = Layer(
        generator.standard_normal((15, 25)).astype(np.float32),
        generator.standard_normal(15).astype(np.float32),
    )
    return Model(
        "m", single_recipe("gps"), np.zeros(25), np.ones(25), (layer,), 5.0, card={"data": "x"}
    )


def test_models_come_back_as_they_were_saved(model, tmp_path):
    save_model(model, tmp_path / "m")
    save_model(model, tmp_path / "m")  # in place of the first
    back = load_model(tmp_path / "m")
    values = np.random.default_rng(1).standard_normal((4, 25))
    np.testing.assert_array_equal(back.embed(values), model.embed(values))
    assert (back.recipe, back.margin, back.card) == (model.recipe, 5.0, {"data": "x"})
    assert back.threshold() == 2.5
    assert {file.name for file in (tmp_path / "m").iterdir()} == {
        "README.md",
        "config.json",
        "model.safetensors",
    }
    assert [file.name for file in tmp_path.iterdir()] == ["m"]


def test_weights_can_be_rounded_to_half_the_room(model, tmp_path):
    for name, half in (("whole", False), ("half", True)):
        save_model(model, tmp_path / name, half_precision=half)
    back = load_model(tmp_path / "half")
    for layer, rounded in zip(model.layers, back.layers, strict=True):
        assert rounded.weight.dtype == np.float32
        np.testing.assert_array_equal(rounded.weight, layer.weight.astype(np.float16))
    np.testing.assert_array_equal(back.mean, model.mean)
    sizes = [(tmp_path / name / "model.safetensors").stat().st_size for name in ("whole", "half")]
    assert sizes[0] - sizes[1] >= 2 * model.layers[0].weight.size


def test_descriptions_say_in_a_line_how_a_model_was_trained(model):
    card = {
        "data": "set",
        "shapes": [f"s{i}" for i in range(100)],
        "validation_shapes": ["v"],
        "training": {"loss": "infonce"},
        "steps_done": 30,
        "seed": 4,
        "curve": [[0, 1.0, None]],
        "note": "On a Monday.",
        "on other_set": "1.5",
    }
    text = model_description(replace(model, card=card))
    assert text.splitlines()[4:] == [
        "- Descriptors: GPS (25), from 300 eigenpairs",
        "- Layers: 25 – 15",
        "- Training: 100 shapes of set (s0 … s99), 30 steps, loss infonce, validated on 1 shapes, "
        "seed 4",
        "- On a Monday.",
        "- On other_set: 1.5",
    ]
    assert "Training" not in model_description(raw_model("hks"))


def test_damaged_models_are_refused(model, tmp_path):
    folder = tmp_path / "m"
    with pytest.raises(InputError, match="There is no model"):
        load_model(folder)
    save_model(model, folder)
    weights, config = folder / "model.safetensors", folder / "config.json"
    whole, text = weights.read_bytes(), config.read_text()
    weights.write_bytes(whole[:-10])
    with pytest.raises(InputError, match=r"model\.safetensors' is damaged"):
        load_model(folder)
    weights.write_bytes(whole)
    other = json.loads(text) | {"recipe": single_recipe("hks").to_json()}
    config.write_text(json.dumps(other))
    with pytest.raises(InputError, match="do not fit its recipe of 100"):
        load_model(folder)
    config.write_text(json.dumps({k: v for k, v in json.loads(text).items() if k != "margin"}))
    with pytest.raises(InputError, match="lacks 'margin'"):
        load_model(folder)
    config.write_text(text.replace('"format": 1', '"format": 9'))
    with pytest.raises(InputError, match="not of the model format"):
        load_model(folder)
    config.write_text("{")
    with pytest.raises(InputError, match=r"config\.json' is damaged"):
        load_model(folder)
    config.write_text(text)
    weights.unlink()
    with pytest.raises(InputError, match=r"There is no .*model\.safetensors"):
        load_model(folder)
    save_model(replace(model, mean=np.full(25, np.nan)), tmp_path / "nan")
    with pytest.raises(InputError, match="not all finite"):
        load_model(tmp_path / "nan")


@pytest.mark.parametrize(
    ("place", "value", "message"),
    [
        (["layers"], [], "`layers` must list the neurons"),
        (["layers"], "25", "`layers` must list the neurons"),
        (["layers"], [25.0, 15], "`layers` must list the neurons"),
        (["layers"], [25], "`layers` has 0 of them, and 'model.safetensors' others"),
        (["layers"], [25, 15, 3], "lacks 'layer1.weight'"),
        (["margin"], "abc", "`margin` must be a positive number or null; got 'abc'"),
        (["margin"], True, "`margin` must be a positive number"),
        (["limit"], -8, "`limit` must be a positive number or null; got -8"),
        (["limit"], float("nan"), "`limit` must be a positive number"),
        (["unit_length"], "yes", "`unit_length` must be true or false"),
        (["card"], "x", "`card` must be an object"),
        (["recipe"], None, "`recipe` must be an object"),
        (["recipe", "eigenpairs"], "300", "needs `eigenpairs`, one or more"),
        (["recipe", "unit_area"], 1, "needs `eigenpairs`, one or more, and `unit_area`"),
        (["recipe", "laplacian"], "umbrella", "no Laplacian 'umbrella'; expected one of cotangent"),
        (["recipe", "descriptors"], [], "needs one descriptor or more"),
        (["recipe", "descriptors"], "hks", "`descriptors` must be a list"),
        (["recipe", "descriptors", 0], "hks", "no descriptor recipe"),
        (["recipe", "descriptors", 0, "kind"], 3, "no descriptor '3'"),
        (["recipe", "descriptors", 0, "count"], "100", "needs a `count` of one or more"),
        (["recipe", "descriptors", 0, "log"], 0, "and `log` true or false"),
        (["recipe", "descriptors", 0, "options"], [1], "options of 'gps' must have names"),
        (["recipe", "descriptors", 0, "options"], {"variant": 1}, "'gps' has these options: none"),
        (["patches"], "geodesic", "Patches must be an object"),
        (["patches"], {"kind": "hexagonal"}, "no patches of a surface"),
        (["patches"], {"kind": "geodesic", "rays": 0}, "Geodesic patches need rings and rays"),
        (["patches"], {"kind": "anisotropic", "longest": -1}, "Anisotropic patches need times"),
    ],
)
def test_wrong_values_in_configurations_are_refused(model, tmp_path, place, value, message):
    save_model(model, tmp_path / "m")
    file = tmp_path / "m" / "config.json"
    config = part = json.loads(file.read_text())
    for key in place[:-1]:
        part = part[key]
    part[place[-1]] = value
    file.write_text(json.dumps(config))
    with pytest.raises(InputError, match=re.escape(message)) as raised:
        load_model(tmp_path / "m")
    assert str(tmp_path / "m") in str(raised.value)


def test_deviations_of_zero_are_refused(model, tmp_path):
    save_model(replace(model, deviation=np.zeros(25)), tmp_path / "m")
    with pytest.raises(InputError, match=r"deviations of .* must be positive"):
        load_model(tmp_path / "m")


def test_models_replace_nothing_but_models(model, tmp_path):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.tex").write_text("")
    with pytest.raises(InputError, match="is no model"):
        save_model(model, tmp_path / "mine")
    save_model(model, tmp_path / "m")
    (tmp_path / "m" / "notes.txt").write_text("mine")
    with pytest.raises(InputError, match=r"'.*m' holds 'notes.txt', which is no file of a model"):
        save_model(model, tmp_path / "m")
    assert (tmp_path / "m" / "notes.txt").read_text() == "mine"
    (tmp_path / "project").mkdir()
    (tmp_path / "project" / "config.json").write_text("{}")
    with pytest.raises(InputError, match="is no model"):
        save_model(model, tmp_path / "project")
    with pytest.raises(InputError, match="is a file, not a folder"):
        save_model(model, tmp_path / "mine" / "thesis.tex" / "b")
    with pytest.raises(InputError, match=r"shape \(n, 25\); got \(3, 4\)"):
        model.embed(np.zeros((3, 4)))
    with pytest.raises(InputError, match="no threshold"):
        raw_model("hks").threshold()
