import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from esd.common import InputError
from esd.datasets.collection import Collection
from esd.datasets.open import open_collection
from esd.datasets.parts import part_of
from esd.datasets.precompute import precompute
from esd.descriptors.recipe import part_recipe, recipe_spectrum, single_recipe
from esd.learning.fit import fit
from esd.learning.model import load_model, save_model
from esd.learning.presets import PRESETS
from esd.mesh.geometry import surface_area
from esd.mesh.mesh import PointCloud
from esd.parallel import Workers

torch = pytest.importorskip("torch", reason="training needs the extra `train`")
from esd.learning.part_training import _draw, _Part, train_on_parts  # noqa: E402

TRAINING = replace(
    PRESETS["partial"],
    recipe=replace(part_recipe(), eigenpairs=40),
    hidden=(24, 12),
    outputs=8,
    blocks=1,
    batch=100,
    steps=6,
    validate_every=2,
)


@pytest.fixture
def two(collection):
    """Two bent copies of one shape."""
    return replace(collection, shapes=collection.shapes[:2])


def test_training_lowers_the_loss_and_finds_points_of_parts(two, collection):
    curve = []
    model = train_on_parts(
        two, replace(TRAINING, steps=80, validate_every=10), on_progress=curve.append
    )
    losses = [loss for _, loss, _ in model.card["curve"]]
    assert losses[-1] < 0.75 * losses[0]
    assert [report.step for report in curve] == list(range(1, 81))
    assert curve[-1].training_loss == losses[-1]
    untrained = train_on_parts(two, replace(TRAINING, steps=1))
    # of a shape that it has not seen: the whole, and a part of it by a seed of its own
    whole = collection.shapes[2].mesh()
    cut = part_of(whole, "cut of 35 %", seed=99)
    share = surface_area(cut.mesh) / surface_area(whole)
    errors = []
    for each in (untrained, model):
        found = recipe_spectrum(each.recipe, cut.mesh).with_area(share)
        part, full = each.embed_spectrum(cut.mesh, found), each.embed_mesh(whole)
        nearest = (part @ full.T).argmax(axis=1)
        away = whole.vertices[nearest] - whole.vertices[cut.original_index()]
        errors.append(np.linalg.norm(away, axis=1).mean())
    assert errors[1] < 0.8 * errors[0]
    assert model.card["parts"] == 20
    assert model.card["data"] == "copies, whole and cut"
    assert model.card["shapes"] == ["c0", "c1"]


def test_templates_are_drawn_as_often_as_they_have_shapes():
    points = np.arange(5, dtype=np.int32)
    counts = {"a": 8, "b": 4}
    parts = tuple(
        _Part(Path(f"{name}{i}"), points, name)
        for name, count in counts.items()
        for i in range(count)
    )
    pairs = [_draw(parts, TRAINING, 0, number) for number in range(300)]
    for pair in pairs:
        assert pair.source is not pair.target
        assert pair.source.template == pair.target.template
    assert np.mean([pair.source.template == "b" for pair in pairs]) == pytest.approx(1 / 3, abs=0.1)
    assert len({pair.source.path for pair in pairs}) == len(parts)


def test_equal_arguments_give_equal_weights(two):
    first, second = (train_on_parts(two, TRAINING, seed=3) for _ in range(2))
    assert_equal_models(first, second)
    other = train_on_parts(two, TRAINING, seed=4)
    assert (other.diffusion.weights["out.bias"] != first.diffusion.weights["out.bias"]).any()


def assert_equal_models(first, second):
    np.testing.assert_array_equal(first.mean, second.mean)
    np.testing.assert_array_equal(first.deviation, second.deviation)
    assert first.diffusion.weights.keys() == second.diffusion.weights.keys()
    for name, weight in first.diffusion.weights.items():
        np.testing.assert_array_equal(weight, second.diffusion.weights[name])


def test_an_interrupted_training_resumes_with_the_parts_that_are_there(two, tmp_path):
    path = tmp_path / "m.checkpoint"
    held = replace(two, shapes=two.shapes[1:])
    whole = train_on_parts(two, TRAINING, validation=held, checkpoint=path)
    assert list(tmp_path.iterdir()) == []

    def interrupt(progress):
        if progress.step == 4:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train_on_parts(two, TRAINING, validation=held, checkpoint=path, on_progress=interrupt)
    files = {file: file.stat().st_mtime_ns for file in (tmp_path / "m.checkpoint.parts").iterdir()}
    assert len(files) == 3 * 11  # parts, and what is known of them

    def unchanged(progress):
        assert progress.step > 4
        assert {file: file.stat().st_mtime_ns for file in files} == files

    with pytest.raises(InputError, match="belongs to another training"):
        train_on_parts(two, replace(TRAINING, batch=50), validation=held, checkpoint=path)
    resumed = train_on_parts(two, TRAINING, validation=held, checkpoint=path, on_progress=unchanged)
    assert_equal_models(whole, resumed)
    first, second = ([list(point) for point in m.card["curve"]] for m in (whole, resumed))
    assert first == second
    assert list(tmp_path.iterdir()) == []


def test_validation_keeps_the_best_weights_and_ends_a_training_that_learns_no_more(two):
    stuck = replace(TRAINING, learning_rate=1e-30, steps=100, validate_every=1)
    model = train_on_parts(two, stuck, validation=two)
    assert model.card["steps_done"] == 11
    assert model.card["validation_shapes"] == ["c0", "c1"]
    assert model.card["validation_loss"] == model.card["curve"][0][2]


def test_a_training_starts_from_a_model(two, tmp_path):
    start = train_on_parts(replace(two, shapes=two.shapes[:1]), TRAINING, name="s")
    still = replace(TRAINING, learning_rate=1e-30, steps=1)
    model = train_on_parts(two, still, start=start)
    assert_equal_models(model, start)  # its weights, and its standardisation
    assert model.card["start"] == "s"
    path = tmp_path / "m.checkpoint"

    def interrupt(progress):
        if progress.step == 4:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train_on_parts(two, TRAINING, start=start, checkpoint=path, on_progress=interrupt)
    with pytest.raises(InputError, match="belongs to another training"):
        train_on_parts(two, TRAINING, checkpoint=path)


def test_a_training_does_not_start_from_another_network(two):
    start = train_on_parts(two, replace(TRAINING, steps=1, outputs=4), name="s")
    with pytest.raises(InputError, match="cannot start from 's': its descriptors or its layers"):
        train_on_parts(two, TRAINING, start=start)
    with pytest.raises(InputError, match="cannot start from 'oriented'"):
        train_on_parts(two, TRAINING, start=load_model("default"))


def test_models_of_parts_come_back_as_they_were_trained(two, blob, tmp_path):
    model = fit(two, replace(TRAINING, standardise=False), name="m")
    assert (model.mean == 0).all()
    assert (model.deviation == 1).all()
    save_model(model, tmp_path / "m")
    back = load_model(tmp_path / "m")
    np.testing.assert_array_equal(back.embed_mesh(blob), model.embed_mesh(blob))
    card = json.loads((tmp_path / "m" / "config.json").read_text())["card"]
    assert card["training"]["blocks"] == 1
    assert card["steps_done"] == 6


def test_what_cannot_be_trained_is_refused_before_anything_is_described(two, tmp_path):
    nothing = replace(two, shapes=tuple(replace(s, mesh=None) for s in two.shapes))
    for wrong in (
        replace(TRAINING, blocks=0),
        replace(TRAINING, hidden=(10,)),
    ):
        with pytest.raises(InputError, match="takes presets with `blocks`"):
            train_on_parts(nothing, wrong)
    with pytest.raises(InputError, match=r"`seed` must be from 0 to 4294967295; got -1"):
        train_on_parts(nothing, TRAINING, seed=-1)
    with pytest.raises(InputError, match="no device 'x'"):
        train_on_parts(nothing, TRAINING, device="x")
    precompute(
        two, replace(single_recipe("gps"), eigenpairs=30), tmp_path / "s.h5", workers=Workers(1)
    )
    store = open_collection(tmp_path / "s.h5")
    with pytest.raises(InputError, match=r"s\.h5' is a store, .* neither surfaces nor parts"):
        train_on_parts(store, TRAINING)
    with pytest.raises(InputError, match="is a store"):
        train_on_parts(nothing, TRAINING, validation=store)
    (tmp_path / "m.parts").write_text("in the way")
    with pytest.raises(InputError, match=r"m\.parts' cannot be written to"):
        train_on_parts(nothing, TRAINING, checkpoint=tmp_path / "m")


SURFACE = replace(
    PRESETS["surface"],
    recipe=replace(PRESETS["surface"].recipe, eigenpairs=40),
    hidden=(24, 12),
    outputs=8,
    batch=100,
    remeshings=1,
    validate_every=10,
)


def test_models_of_whole_surfaces_learn_from_whole_shapes_and_their_copies(two, collection):
    models = [fit(two, replace(SURFACE, steps=steps)) for steps in (1, 60)]
    assert models[1].card["parts"] == 4  # two shapes, and a copy of each
    assert models[1].card["data"] == "copies"
    assert not models[1].layers
    source, target = (shape.mesh() for shape in (collection.shapes[0], collection.shapes[2]))
    errors = []
    for model in models:
        index = (model.embed_mesh(source) @ model.embed_mesh(target).T).argmax(axis=1)
        away = target.vertices[index] - target.vertices  # the same triangles
        errors.append(np.linalg.norm(away, axis=1).mean())
    assert errors[1] < 0.75 * errors[0]


def test_shapes_that_cannot_be_cut_or_have_nothing_in_common_are_refused(two, blob):
    cloud = replace(two.shapes[0], mesh=lambda: PointCloud(blob.vertices))
    with pytest.raises(InputError, match=r"'c0': .*no faces"):
        train_on_parts(Collection("x", (cloud,)), TRAINING)
    index = np.full(len(blob.vertices), -1)
    index[:5] = np.arange(5)
    bare = replace(two, shapes=tuple(replace(s, correspondence=lambda: index) for s in two.shapes))
    with pytest.raises(InputError, match="none had enough points of a template in common"):
        train_on_parts(bare, TRAINING)


def test_the_command_trains_on_shapes_with_correspondences_alone(run, shapes, tmp_path):
    where = ("-o", tmp_path / "model", "--preset", "partial")
    done = run("train", shapes, *where, "--steps", 2, "--include", "*[01]0")
    assert "trained 2 steps on 2 shapes" in done.stdout
    model = load_model(tmp_path / "model")
    assert model.diffusion.block_count == 4
    assert {file.name for file in tmp_path.iterdir()} == {"model", "set"}
    done = run("precompute", shapes, "-o", tmp_path / "s.h5", "--preset", "partial", expect=1)
    assert "learns from surfaces, which a store does not hold" in done.stderr
