import json
import re
from dataclasses import replace

import numpy as np
import pytest

from esd.common import InputError
from esd.datasets.collection import Collection
from esd.datasets.open import open_collection
from esd.datasets.precompute import precompute
from esd.descriptors.recipe import Descriptor, Recipe, single_recipe
from esd.learning.device import usable_device
from esd.learning.losses import contrastive_loss, infonce_loss, pair_criteria
from esd.learning.model import (
    Layer,
    Model,
    load_model,
    model_description,
    raw_model,
    save_model,
)
from esd.learning.pairs import draw_matches, draw_pairs
from esd.learning.presets import PRESETS, Training, preset
from esd.learning.table import point_table, standardisation, stored_table
from esd.parallel import Workers

torch = pytest.importorskip("torch", reason="training needs the extra `train`")
from esd.learning.train import learning_rate, train  # noqa: E402

TRAINING = Training(
    Recipe((Descriptor("hks", 12),), eigenpairs=20), hidden=(10,), outputs=4, steps=1500, batch=64
)


def test_half_of_the_pairs_correspond_and_labels_are_soft(collection):
    table = point_table(collection, TRAINING.recipe)
    batch = draw_pairs(table, np.random.default_rng(0), count=512, soft_label=0.2)
    size = len(collection.shapes[0].mesh().vertices)
    same = batch.source % size == batch.target % size
    np.testing.assert_array_equal(same, np.arange(512) < 256)
    assert (batch.label[:256] == 1).all()
    assert 0 <= batch.label[256:].min() < 0.02
    assert 0.18 < batch.label[256:].max() <= 0.2
    assert not (np.concatenate([batch.source, batch.target]) % size == 7).any()
    assert len({*(batch.source // size), *(batch.target // size)}) == 2  # two shapes


def test_standardised_columns_have_mean_zero_and_deviation_one(collection):
    table = point_table(collection, TRAINING.recipe)
    values = table.standardised(*standardisation(table)).values
    np.testing.assert_allclose(values.mean(axis=0), 0, atol=1e-4)
    np.testing.assert_allclose(values.std(axis=0), 1, atol=1e-4)


def test_loss_is_the_paper_s():
    squared = np.array([2.0, 2.0, 6.0, 2.0])
    label = np.array([1.0, 0.0, 0.0, 0.2])
    np.testing.assert_allclose(
        contrastive_loss(squared, label, margin=5.0), [2, 3, 0, 0.2 * 2 + 0.8 * 3]
    )
    criteria = pair_criteria(
        np.array([1.0, 3.0, 1.0, 3.0, 4.0, 4.0]), np.array([1, 1, 0, 0, 0, 0.1]), margin=5.0
    )
    assert criteria.miss_rate == 0.5
    assert criteria.false_match_rate == 0.25
    assert criteria.error_rate == 0.75
    assert criteria.loss_mean == pytest.approx(criteria.loss_sum / 6)


def test_infonce_is_the_cross_entropy_of_finding_the_match():
    generator = torch.Generator().manual_seed(0)
    source, target = (
        torch.nn.functional.normalize(torch.randn(7, 4, generator=generator), dim=1)
        for _ in range(2)
    )
    truth = torch.arange(7)
    both = [
        torch.nn.functional.cross_entropy(a @ b.T / 0.1, truth, reduction="none")
        for a, b in ((source, target), (target, source))
    ]
    found = infonce_loss(source, target, temperature=0.1)
    torch.testing.assert_close(found, sum(both) / 2)


def test_matches_are_drawn_without_repetition(collection):
    table = point_table(collection, TRAINING.recipe)
    size = len(collection.shapes[0].mesh().vertices)
    batch = draw_matches(table, np.random.default_rng(0), count=10**6)
    assert sorted(batch.source % size) == [i for i in range(size) if i != 7]
    np.testing.assert_array_equal(batch.source % size, batch.target % size)
    assert batch.source[0] // size != batch.target[0] // size


def test_a_table_of_some_points_has_the_same_points_of_all_shapes(collection):
    whole = point_table(collection, TRAINING.recipe)
    some = point_table(collection, TRAINING.recipe, points=40)
    assert len(some.values) <= 40 * len(collection.shapes)
    index = np.array([np.flatnonzero((whole.values == row).all(axis=1))[0] for row in some.values])
    size = len(collection.shapes[0].mesh().vertices)
    points = {tuple(sorted(index[rows[rows >= 0]] % size)) for rows in some.rows}
    assert len(points) == 1
    assert 39 <= len(*points) <= 40  # one point of the template is on no shape


def test_infonce_trains_an_embedding_of_unit_length(collection):
    training = replace(
        TRAINING,
        loss="infonce",
        schedule="cosine",
        learning_rate=5e-3,
        limit=4.0,
        remeshings=1,
        dropout=0.1,
    )
    losses = []
    model = train(
        collection,
        replace(training, steps=1000),
        validation=collection,
        on_progress=lambda p: losses.append(p.validation_loss),
    )
    assert losses[-1] < losses[0]
    embedded = model.embed_mesh(collection.shapes[0].mesh())
    np.testing.assert_allclose(np.linalg.norm(embedded, axis=1), 1)
    assert model.margin is None
    far = model.mean + 100 * model.deviation
    np.testing.assert_allclose(
        model.embed(far[None]), model.embed(model.mean[None] + 4 * model.deviation), rtol=1e-9
    )
    assert learning_rate(training, 0) == 5e-3
    assert learning_rate(training, training.steps) == pytest.approx(5e-3 / 20)


def test_training_separates_pairs_and_embeds_without_torch(collection):
    trained = train(collection, TRAINING, seed=1, validation=collection)
    untrained = train(collection, replace(TRAINING, steps=1), seed=1, validation=collection)
    assert trained.card["validation_loss"] < 0.7 * untrained.card["validation_loss"]
    mesh = collection.shapes[0].mesh()
    network = torch.nn.Sequential(torch.nn.Linear(12, 10), torch.nn.ReLU(), torch.nn.Linear(10, 4))
    with torch.no_grad():
        for module, layer in zip(network[::2], trained.layers, strict=True):
            module.weight.copy_(torch.from_numpy(layer.weight))
            module.bias.copy_(torch.from_numpy(layer.bias))
        values = np.random.default_rng(0).standard_normal((5, 12))
        theirs = network(torch.from_numpy((values - trained.mean) / trained.deviation).float())
    np.testing.assert_allclose(
        trained.embed(values), theirs.numpy(), rtol=1e-4, atol=1e-4
    )  # 32 bit
    assert trained.embed_mesh(mesh).shape == (len(mesh.vertices), 4)


def test_training_from_a_store_is_that_in_memory(collection, tmp_path):
    path = tmp_path / "s.h5"
    precompute(collection, TRAINING.recipe, path, workers=Workers(1))
    short = replace(TRAINING, steps=50, points=40)
    stored = train(open_collection(path), short, validation=open_collection(path))
    direct = train(collection, replace(short, points=None), validation=collection)
    # the same draws; mean and deviation are those of the shapes combined, equal to rounding
    np.testing.assert_allclose(stored.mean, direct.mean, rtol=1e-6)
    np.testing.assert_allclose(stored.deviation, direct.deviation, rtol=1e-6)
    for a, b in zip(stored.layers, direct.layers, strict=True):
        np.testing.assert_allclose(a.weight, b.weight, atol=1e-3)
    table = stored_table(open_collection(path), TRAINING.recipe)
    assert isinstance(table.values, np.memmap)
    plain = train(open_collection(path), replace(short, standardise=False, steps=2))
    assert (plain.mean == 0).all()


def test_stores_of_other_recipes_are_not_trained_on(collection, tmp_path):
    path = tmp_path / "s.h5"
    precompute(collection, TRAINING.recipe, path, workers=Workers(1))
    opened = open_collection(path)
    for other in (replace(TRAINING, recipe=single_recipe("gps")), replace(TRAINING, remeshings=1)):
        with pytest.raises(InputError, match="does not hold what this training takes"):
            train(opened, other)
    with pytest.raises(InputError, match="is a store; see `stored_table`"):
        point_table(opened, TRAINING.recipe)


def test_copies_in_a_store_are_trained_on(collection, tmp_path):
    path = tmp_path / "s.h5"
    precompute(collection, TRAINING.recipe, path, remeshings=1, workers=Workers(1))
    opened = open_collection(path)
    assert len(opened.shapes) == 4
    assert len(stored_table(opened, TRAINING.recipe, copies=1).rows) == 8
    assert len(stored_table(opened, TRAINING.recipe).rows) == 4


def test_equal_seeds_give_equal_weights_and_others_do_not(collection):
    short = replace(TRAINING, steps=20)
    weights = [train(collection, short, seed=seed).layers[0].weight for seed in (1, 1, 2)]
    np.testing.assert_array_equal(weights[0], weights[1])
    assert not np.array_equal(weights[0], weights[2])


def test_small_networks_are_trained_in_one_thread_and_others_keep_theirs(collection):
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    try:
        small = train(collection, replace(TRAINING, steps=1))
        large = train(collection, replace(TRAINING, hidden=(2000, 2000), steps=1))
        assert (small.card["threads"], large.card["threads"]) == (1, 2)
        assert torch.get_num_threads() == 2
    finally:
        torch.set_num_threads(before)


def test_training_takes_a_gpu_where_there_is_one(collection, monkeypatch):
    short = replace(TRAINING, steps=20)
    here = train(collection, short)
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    anywhere = train(collection, short, device="auto")
    np.testing.assert_array_equal(here.layers[0].weight, anywhere.layers[0].weight)
    assert here.card["device"] == "cpu"
    with pytest.raises(InputError, match="torch finds no GPU here"):
        train(collection, short, device="cuda")
    with pytest.raises(InputError, match="There is no device 'tpu'"):
        train(collection, short, device="tpu")
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    assert [usable_device(name) for name in ("auto", "cuda", "cpu")] == ["cuda", "cuda", "cpu"]


@pytest.mark.skipif(not torch.cuda.is_available(), reason="there is no GPU")
@pytest.mark.parametrize("loss", ["contrastive", "infonce"])
def test_a_gpu_learns_the_same_to_rounding(collection, loss, tmp_path):
    short = replace(TRAINING, steps=20, loss=loss, dropout=0.1)
    here, there = (train(collection, short, device=name) for name in ("cpu", "cuda"))
    for one, other in zip(here.layers, there.layers, strict=True):
        # float32 rounds at 1e-7, which twenty steps of Adam carry on
        np.testing.assert_allclose(one.weight, other.weight, atol=1e-4)


def test_interrupted_training_goes_on_to_the_same_weights(collection, tmp_path):
    class StopError(Exception):
        pass

    def stop(progress):
        if progress.step == 1000:
            raise StopError

    straight = train(collection, TRAINING, validation=collection)
    path = tmp_path / "checkpoint"
    with pytest.raises(StopError):
        train(collection, TRAINING, validation=collection, checkpoint=path, on_progress=stop)
    assert path.exists()
    steps = []
    resumed = train(
        collection,
        TRAINING,
        validation=collection,
        checkpoint=path,
        on_progress=lambda p: steps.append(p.step),
    )
    assert steps == [1500]
    for a, b in zip(straight.layers, resumed.layers, strict=True):
        np.testing.assert_array_equal(a.weight, b.weight)
        np.testing.assert_array_equal(a.bias, b.bias)
    assert not path.exists()


def test_checkpoints_of_other_trainings_are_refused(collection, tmp_path):
    path = tmp_path / "checkpoint"

    def stop(progress):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train(collection, TRAINING, checkpoint=path, on_progress=stop)
    with pytest.raises(InputError, match="belongs to another training"):
        train(collection, TRAINING, checkpoint=path, seed=1)
    path.write_bytes(path.read_bytes()[:50])
    with pytest.raises(InputError, match="is damaged"):
        train(collection, TRAINING, checkpoint=path)


def test_impossible_trainings_are_refused(collection):
    with pytest.raises(InputError, match="at least two shapes"):
        train(Collection("one", collection.shapes[:1]), TRAINING)
    with pytest.raises(InputError, match="`seed` must be"):
        train(collection, TRAINING, seed=-1)
    beyond = replace(collection.shapes[0], correspondence=lambda: np.array([10**6]))
    with pytest.raises(InputError, match="names vertex 1000000"):
        train(Collection("x", (beyond,)), TRAINING)
    with pytest.raises(InputError, match="no preset 'x'"):
        preset("x")


def test_presets_have_the_paper_s_layers():
    paper = {name: t for name, t in PRESETS.items() if name.startswith("paper")}
    assert {name: (t.recipe.width, *t.hidden, t.outputs) for name, t in paper.items()} == {
        "paper-hks": (100, 78, 32, 15),
        "paper-wks": (100, 78, 32, 15),
        "paper-gps": (25, 20, 18, 15),
    }


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


def test_descriptions_say_in_a_line_how_a_model_was_trained(model):
    card = {
        "data": "set",
        "shapes": [f"s{i}" for i in range(100)],
        "validation_shapes": ["v"],
        "training": {"loss": "infonce"},
        "steps_done": 30,
        "seed": 4,
        "curve": [[0, 1.0, None]],
        "on other_set": "1.5",
    }
    text = model_description(replace(model, card=card))
    assert text.splitlines()[4:] == [
        "- Descriptors: GPS (25), from 300 eigenpairs",
        "- Layers: 25 – 15",
        "- Training: 100 shapes of set (s0 … s99), 30 steps, loss infonce, validated on 1 shapes, "
        "seed 4",
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
