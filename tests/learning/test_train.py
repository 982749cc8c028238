from dataclasses import replace

import numpy as np
import pytest

from esd.common import InputError
from esd.datasets.collection import Collection
from esd.datasets.open import open_collection
from esd.datasets.precompute import precompute
from esd.descriptors.recipe import Descriptor, Recipe, single_recipe
from esd.learning.device import usable_device
from esd.learning.presets import Training, preset
from esd.learning.table import point_table, stored_table
from esd.parallel import Workers

torch = pytest.importorskip("torch", reason="training needs the extra `train`")
from esd.learning.train import learning_rate, train  # noqa: E402

TRAINING = Training(
    Recipe((Descriptor("hks", 12),), eigenpairs=20), hidden=(10,), outputs=4, steps=1500, batch=64
)


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
