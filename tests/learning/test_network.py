import json
from dataclasses import replace

import numpy as np
import pytest

from esd.common import InputError
from esd.datasets.collection import Collection, Shape
from esd.descriptors.recipe import Descriptor, Recipe, descriptors
from esd.evaluation.protocol import evaluate
from esd.learning.acnn import AnisotropicPatches
from esd.learning.gcnn import GeodesicPatches
from esd.learning.model import load_model, model_description, save_model
from esd.learning.presets import Training
from esd.learning.table import point_table
from esd.matching.match import match
from esd.mesh.mesh import Mesh, PointCloud

torch = pytest.importorskip("torch", reason="training needs the extra `train`")
from esd.learning.network import convolved, seeded_network  # noqa: E402
from esd.learning.train import train  # noqa: E402

TRAINING = Training(
    Recipe((Descriptor("hks", 12),), eigenpairs=20),
    hidden=(8,),
    outputs=6,
    batch=64,
    learning_rate=5e-3,
    steps=120,
    validate_every=40,
    patches=GeodesicPatches(rings=2, rays=6, radius=0.1),
    convolutions=(1,),
)
TRAININGS = {
    "geodesic": TRAINING,
    "anisotropic": replace(
        TRAINING,
        patches=AnisotropicPatches(times=2, angles=3, entries=8),
        hidden=(8, 5),
        convolutions=(1, 2),
    ),
    "in the middle": replace(TRAINING, hidden=(8, 5), convolutions=(1,)),
}


@pytest.fixture
def shapes(blob):
    """Four bent copies of one shape; the last vertex has no face."""

    def copy(i):
        bend = np.sin(np.arange(3) + blob.vertices[:, [1, 2, 0]] * (1 + 0.3 * i))
        vertices = blob.vertices + 0.1 * i * bend
        return Mesh(np.concatenate([vertices, [[3.0, 3, 3]]]), blob.faces)

    index = np.arange(len(blob.vertices) + 1)
    return [Shape(f"c{i}", f"s{i}", "t", lambda i=i: copy(i), lambda: index) for i in range(4)]


@pytest.fixture
def collection(shapes):
    return Collection("copies", tuple(shapes[:3]))


@pytest.mark.parametrize("kind", TRAININGS)
def test_training_lowers_the_loss_on_a_shape_held_out(kind, collection, shapes, tmp_path):
    training, held_out = TRAININGS[kind], Collection("held out", tuple(shapes[2:]))
    model = train(replace(collection, shapes=collection.shapes[:2]), training, validation=held_out)
    losses = [held for _, _, held in model.card["curve"]]
    assert [step for step, _, _ in model.card["curve"]] == [40, 80, 120]
    untrained = train(collection, replace(training, steps=1), validation=held_out)
    assert model.card["validation_loss"] == min(losses)
    assert min(losses) < 0.7 * untrained.card["validation_loss"]

    save_model(model, tmp_path / "m")
    back = load_model(tmp_path / "m")
    mesh = shapes[3].mesh()
    values = back.embed_mesh(mesh)
    assert back.patches == training.patches
    np.testing.assert_array_equal(values, model.embed_mesh(mesh))
    assert np.isnan(values[-1]).all()
    assert np.isfinite(values[:-1]).all()
    assert "Convolutions: layers" in model_description(back)


@pytest.mark.parametrize("kind", TRAININGS)
def test_models_embed_as_the_network_does(kind, collection):
    training = TRAININGS[kind]
    model = train(collection, replace(training, steps=1), seed=3)
    widths = [12, *training.hidden, training.outputs]
    network = seeded_network(widths, 3, training.patches, training.convolutions)
    with torch.no_grad():
        for parameter, trained in zip(
            network.parameters(),
            (array for layer in model.layers for array in (layer.weight, layer.bias)),
            strict=True,
        ):
            assert parameter.shape == trained.shape
            parameter.copy_(torch.from_numpy(trained))
        table = point_table(collection, training.recipe, patches=training.patches)
        table = table.standardised(model.mean, model.deviation)
        size = table.operators[0].shape[1]
        shape = table.whole_shape(np.array([size + 5, size + 9]))  # of the second shape
        values = torch.from_numpy(shape.values)
        found = convolved(network, values, shape.operator, shape.vertices).numpy()
    expected = model.embed_mesh(collection.shapes[1].mesh())[[5, 9]]
    np.testing.assert_allclose(found, expected, rtol=1e-3, atol=1e-4)  # 32 bit


def test_gradients_are_those_of_differences(collection):
    training = TRAININGS["anisotropic"]
    table = point_table(collection, training.recipe, patches=training.patches)
    shape = table.whole_shape(np.array([3, 70, 70]))
    network = seeded_network([12, 8, 5, 6], 0, training.patches, training.convolutions)
    values = torch.from_numpy(shape.values / shape.values.max())

    def energy():
        return (convolved(network, values, shape.operator, shape.vertices) ** 2).sum()

    energy().backward()
    weight = network[0].weight
    slope, step = float(weight.grad[2, 5]), 1e-2
    with torch.no_grad():
        weight[2, 5] += step
        above = float(energy())
        weight[2, 5] -= 2 * step
        below = float(energy())
    # 32 bit; only ReLU bends
    assert slope == pytest.approx((above - below) / (2 * step), rel=0.02, abs=1e-6)


def test_interrupted_training_goes_on_to_the_same_weights_and_curve(collection, tmp_path):
    class StopError(Exception):
        pass

    def stop(progress):
        if progress.step == 80:
            raise StopError

    path = tmp_path / "checkpoint"
    straight = train(collection, TRAINING, validation=collection)
    with pytest.raises(StopError):
        train(collection, TRAINING, validation=collection, checkpoint=path, on_progress=stop)
    resumed = train(collection, TRAINING, validation=collection, checkpoint=path)
    for a, b in zip(straight.layers, resumed.layers, strict=True):
        np.testing.assert_array_equal(a.weight, b.weight)
    assert [list(row) for row in straight.card["curve"]] == [
        list(row) for row in resumed.card["curve"]
    ]


def test_convolutional_models_match_and_are_evaluated(collection, shapes):
    model = train(collection, replace(TRAINING, steps=1))
    found = match(shapes[0].mesh(), shapes[1].mesh(), model=model)
    assert found.target_index[-1] == -1
    result, _ = evaluate(model, [(shapes[0], shapes[1])])
    assert result.pairs == 1


def test_convolutions_of_what_is_no_whole_shape_are_refused(collection, shapes, tmp_path):
    with pytest.raises(InputError, match="Convolutions need whole shapes"):
        train(collection, replace(TRAINING, points=10))
    model = train(collection, replace(TRAINING, steps=1))
    mesh = shapes[0].mesh()
    with pytest.raises(InputError, match="embeds all vertices of a shape together"):
        model.embed(descriptors(model.recipe, mesh))
    with pytest.raises(InputError, match="Points have no faces, which patches need"):
        model.embed_mesh(PointCloud(mesh.vertices[:-1]))

    save_model(model, tmp_path / "m")
    path = tmp_path / "m" / "config.json"
    config = json.loads(path.read_text())
    path.write_text(json.dumps(config | {"patches": None}))
    with pytest.raises(InputError, match="do not fit its recipe"):
        load_model(tmp_path / "m")
    path.write_text(json.dumps(config | {"patches": config["patches"] | {"rays": 7}}))
    with pytest.raises(InputError, match="do not fit its recipe"):
        load_model(tmp_path / "m")
