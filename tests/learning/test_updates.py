from dataclasses import replace

import numpy as np
import pytest

from esd.common import InputError
from esd.learning.model import load_model, raw_model
from esd.learning.presets import PRESETS
from esd.learning.samples import Samples
from esd.learning.teacher import Lesson

torch = pytest.importorskip("torch", reason="training needs the extra `train`")
from esd.learning.network import seeded_network  # noqa: E402
from esd.learning.updates import (  # noqa: E402
    Matches,
    embedding_by,
    infonce_of_matches,
    layers_of,
    network_of,
)

TRAINING = replace(PRESETS["oriented"], dropout=0.0, temperature=0.5)
IDENTITY = torch.nn.Sequential(torch.nn.Identity())


def samples(values, *, apart: float = 1.0, known=()) -> Samples:
    """Points in a row, by default too far apart to be the same."""
    count = len(values)
    places = np.zeros((count, 3), dtype=np.float32)
    places[:, 0] = apart * np.arange(count)
    rows = np.asarray(values, dtype=np.float32)
    vectors = np.zeros((count, 1), dtype=np.float32)
    return Samples(
        "x",
        (rows,),
        vectors,
        places,
        places,
        np.arange(count),
        known=dict(zip("abc", known, strict=False)),
    )


def loss(source, target, lesson, *, batch=3) -> float:
    return float(
        infonce_of_matches(
            IDENTITY,
            Matches(source, target, lesson),
            TRAINING,
            batch=batch,
            generator=np.random.default_rng(0),
            dropout=torch.Generator().manual_seed(0),
        )
    )


def test_the_loss_is_infonce_weighed_by_what_could_be_relied_on():
    axes = samples(np.eye(3))
    rows = np.arange(3)
    # similarities over the temperature: two at the match, zero at the two others
    whole = np.log(1 + 2 * np.exp(-2))
    assert loss(axes, axes, Lesson(rows, rows, 1.0, 1.0, 1.0)) == pytest.approx(whole, rel=1e-5)
    half = Lesson(rows, rows, 0.5, 1.0, 0.5)
    assert loss(axes, axes, half) == pytest.approx(whole / 4, rel=1e-5)


def test_points_near_each_other_are_no_negatives():
    crowded = samples(np.eye(3), apart=0.01)
    rows = np.arange(3)
    assert loss(crowded, crowded, Lesson(rows, rows, 1.0, 1.0, 1.0)) == pytest.approx(0, abs=1e-6)


def test_known_points_are_learned_beside_the_map():
    source, target = samples(np.eye(3), known=[0]), samples(np.eye(3)[[0, 0, 0]], known=[0])
    nothing = Lesson(np.array([], int), np.array([], int), 1.0, 1.0, 1.0)
    # one known match alone is certain
    assert loss(source, target, nothing) == pytest.approx(0, abs=1e-6)


def test_a_network_and_a_model_have_the_same_weights():
    model = replace(load_model("default"), diffusion=None)
    network = network_of(model)
    for layer, back in zip(model.layers, layers_of(network), strict=True):
        np.testing.assert_array_equal(back.weight, layer.weight)
        np.testing.assert_array_equal(back.bias, layer.bias)
    values = np.random.default_rng(0).standard_normal((5, model.recipe.width)).astype(np.float32)
    values = np.clip(values, -model.limit, model.limit)
    standard = values * model.deviation + model.mean
    np.testing.assert_allclose(embedding_by(network)(values), model.embed(standard), atol=1e-4)


def test_embeddings_have_unit_length():
    network = seeded_network([4, 6, 3], 1)
    rows = embedding_by(network)(np.random.default_rng(0).standard_normal((7, 4)).astype("f4"))
    np.testing.assert_allclose(np.linalg.norm(rows, axis=1), 1, rtol=1e-6)


def test_models_of_other_kinds_cannot_learn_without_correspondences():
    for name in ("hks", "paper-hks"):
        model = raw_model("hks") if name == "hks" else load_model(name)
        with pytest.raises(InputError, match=f"'{name}' cannot learn without correspondences"):
            network_of(model)
