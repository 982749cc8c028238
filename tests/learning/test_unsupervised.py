from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from esd.common import InputError
from esd.datasets.collection import Collection, Shape
from esd.datasets.deformation import deformed
from esd.learning.diffusion import diffusion_network
from esd.learning.model import load_model, save_model
from esd.learning.presets import Training, preset
from esd.learning.teacher import FirstMaps
from esd.mesh.mesh import Mesh
from esd.mesh.shapes import torus
from esd.nearest import nearest
from knobbed import RECIPE, knobbed, knobbed_shape, truth

pytest.importorskip("torch", reason="training needs the extra `train`")
from esd.learning.diffusion_torch import seeded_layers
from esd.learning.unsupervised import Teaching, train_unsupervised

TRAINING = Training(RECIPE, hidden=(64,), outputs=16, limit=8.0, dropout=0.2, loss="infonce")
TEACHING = Teaching(
    steps=60, points=642, drawn=500, batch=250, copies=2, learning_rate=1e-2, validate_every=30
)


def error(model, first: int, second: int) -> float:
    """Mean distance of the nearest embeddings from the truth; the shapes are about six wide."""
    source, target = knobbed(first), knobbed(second)
    found, _ = nearest(model.embed_mesh(source), model.embed_mesh(target))
    away = target.vertices[found] - target.vertices[truth(first, second)]
    return float(np.linalg.norm(away, axis=1).mean())


def test_shapes_never_seen_are_matched_after_training_without_correspondences(unregistered):
    before = train_unsupervised(unregistered, TRAINING, teaching=replace(TEACHING, steps=1))
    model = train_unsupervised(unregistered, TRAINING, teaching=TEACHING)
    errors = [[error(each, *pair) for pair in ((10, 11), (12, 13))] for each in (before, model)]
    assert np.mean(errors[1]) < 0.6
    assert np.mean(errors[1]) < 0.85 * np.mean(errors[0])
    card = model.card
    assert card["groups"] == [["s0", "s1", "s2", "s3", "s4"]]
    assert card["left_out"] == {}
    assert [point["step"] for point in card["curve"]] == [30, 60]
    assert card["curve"][1]["returning"] > 0.8


def test_an_interrupted_training_resumes_to_the_same_weights(unregistered, tmp_path):
    class StopError(Exception):
        pass

    def stop(progress):
        if progress.step == 2:
            raise StopError

    short = replace(TEACHING, steps=4, drawn=300, copies=1, validate_every=2)
    run = partial(train_unsupervised, unregistered, TRAINING, teaching=short, seed=3)
    whole = run()
    file = tmp_path / "checkpoint"
    with pytest.raises(StopError):
        run(checkpoint=file, on_progress=stop)
    resumed = run(checkpoint=file)
    assert not file.exists()
    for first, second in zip(whole.layers, resumed.layers, strict=True):
        np.testing.assert_array_equal(first.weight, second.weight)
    assert whole.card["curve"] == resumed.card["curve"]
    with pytest.raises(StopError):
        run(checkpoint=file, on_progress=stop)
    with pytest.raises(InputError, match="belongs to another training"):
        run(checkpoint=file, seed=4)
    file.write_bytes(b"damaged")
    with pytest.raises(InputError, match="is damaged"):
        run(checkpoint=file)


def test_models_are_saved_with_their_curve_and_can_be_started_from(unregistered, tmp_path):
    short = replace(TEACHING, steps=2, validate_every=1)
    held = Collection("held", (knobbed_shape(7),))
    model = train_unsupervised(unregistered, TRAINING, teaching=short, validation=held)
    assert all(0 <= point["validation"] <= 1 for point in model.card["curve"])
    assert model.card["validation_shapes"] == ["s7"]
    save_model(model, tmp_path / "model")
    start = load_model(tmp_path / "model")
    width = TRAINING.recipe.width
    network = diffusion_network(seeded_layers(width, 8, 6, 4, 1, seed=0).arrays(), inputs=width)
    start = replace(start, diffusion=network)
    slow = replace(short, learning_rate=1e-9)
    other = train_unsupervised(unregistered, TRAINING, teaching=slow, start=start)
    for first, second in zip(start.layers, other.layers, strict=True):
        np.testing.assert_allclose(first.weight, second.weight, atol=1e-7)
    assert other.card["start"] == "model"
    assert other.diffusion is network  # stays beside the layers
    with pytest.raises(InputError, match="cannot start from 'model'"):
        train_unsupervised(unregistered, preset("oriented"), teaching=short, start=start)


def test_known_correspondences_and_broken_shapes_among_others(unregistered):
    flat = Mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    broken = Shape("flat", "flat", "only flat", lambda: flat, partial(np.arange, 3))
    some = (
        knobbed_shape(0, template="ball"),
        knobbed_shape(1, template="ball"),
        broken,
        knobbed_shape(2),
    )
    short = replace(TEACHING, steps=2)
    model = train_unsupervised(Collection("some", some), TRAINING, teaching=short)
    assert model.card["shapes"] == ["s0", "s1", "s2"]
    assert model.card["known"] == ["s0", "s1"]
    assert list(model.card["left_out"]) == ["flat"]
    with pytest.raises(InputError, match=r"2 shapes or more.*got 1 that can be used. 'flat': "):
        train_unsupervised(Collection("one", some[2:]), TRAINING, teaching=short)
    seen = []
    with pytest.raises(InputError, match=r"got 1 that can be used\.$"):  # before any is described
        train_unsupervised(
            Collection("one", some[:1]), TRAINING, on_shape=lambda: seen.append(True)
        )
    assert not seen
    with pytest.raises(InputError, match="takes presets with loss 'infonce'"):
        train_unsupervised(unregistered, preset("paper-hks"))
    with pytest.raises(InputError, match="`seed` must be from 0"):
        train_unsupervised(unregistered, TRAINING, seed=-1)


def test_shapes_of_another_class_are_a_group_of_their_own(unregistered):
    mesh = torus(32, 20)
    rings = [deformed(mesh, seed=seed, strain=0.1) for seed in (20, 21)]
    other = [
        Shape(f"ring{i}", f"{i}", f"only {i}", partial(Mesh, ring.vertices, ring.faces), len)
        for i, ring in enumerate(rings)
    ]
    mixed = Collection("mixed", (*other, *unregistered.shapes))
    model = train_unsupervised(mixed, TRAINING, teaching=TEACHING)
    assert model.card["groups"][0] == ["s0", "s1", "s2", "s3", "s4"]


def test_two_shapes_are_trained_on_with_a_warning(unregistered, caplog):
    two = replace(unregistered, shapes=unregistered.shapes[:2])
    model = train_unsupervised(two, TRAINING, teaching=replace(TEACHING, steps=1))
    assert "A model of 2 shapes will hardly be good for others" in caplog.text
    assert sum(len(group) for group in model.card["groups"]) == 2


def test_many_shapes_keep_fewer_points_and_no_copies(unregistered, monkeypatch):
    run = partial(train_unsupervised, unregistered, TRAINING, teaching=replace(TEACHING, steps=1))
    of_a_point = 4 * RECIPE.width * len(unregistered.shapes)
    monkeypatch.setattr("esd.learning.unsupervised._FEWEST_POINTS", 100)
    for points, expected in ((3 * 300, (300, 2)), (250, (250, 0))):
        monkeypatch.setattr("esd.learning.unsupervised._LARGEST_MEMORY", of_a_point * points)
        used = run().card["teaching"]
        assert (used["points"], used["copies"]) == expected
    monkeypatch.setattr("esd.learning.unsupervised._LARGEST_MEMORY", of_a_point * 99)
    with pytest.raises(
        InputError, match=r"5 shapes are more than .* can hold in memory; choose 4 "
    ):
        run()


def test_a_warm_up_takes_copies_alone(unregistered):
    warm = replace(TEACHING, steps=8, warm_up=2, validate_every=2, drawn=300)
    curve = train_unsupervised(unregistered, TRAINING, teaching=warm).card["curve"]
    assert curve[0]["returning"] is None
    assert curve[0]["loss"] > 0
    assert 0 < curve[1]["returning"] <= 1


def test_first_maps_are_learned_during_the_warm_up_and_say_what_belongs_together(unregistered):
    def exact(samples):
        rows = [np.argsort(each.vertices) for each in samples]
        maps = {
            (i, j): rows[j][truth(i, j)[samples[i].vertices]]
            for i in range(3)
            for j in range(3)
            if i != j
        }
        return FirstMaps(maps, {pair: pair for pair in maps})

    settings = replace(TEACHING, steps=6, warm_up=2, validate_every=2, drawn=300, own_share=0.0)
    run = partial(train_unsupervised, unregistered, TRAINING, teaching=settings)
    plain, taught = run(), run(first_maps=exact)
    assert plain.card["curve"][0]["loss"] != taught.card["curve"][0]["loss"]
    assert taught.card["curve"][0]["returning"] is None
    assert taught.card["groups"] == [["s0", "s1", "s2"], ["s3"], ["s4"]]
    # a training that is started from a model has better maps than the first
    other = run(start=plain, first_maps=lambda _: pytest.fail("not needed"))
    assert other.card["start"] == "model"
    other = run(first_maps=lambda samples: replace(exact(samples), start=plain))
    assert other.card["start"] == "model"
    assert taught.card["start"] is None


def test_doubles_are_left_out(unregistered):
    twice = replace(knobbed_shape(0), name="again")
    some = replace(unregistered, shapes=(*unregistered.shapes[:3], twice))
    model = train_unsupervised(some, TRAINING, teaching=replace(TEACHING, steps=1))
    assert model.card["shapes"] == ["s0", "s1", "s2"]
    assert model.card["left_out"] == {"again": "it is the same mesh as 's0'"}
