from dataclasses import replace

import numpy as np
import pytest

from esd.common import InputError
from esd.learning.diffusion import diffusion_network
from esd.learning.model import load_model, raw_model
from esd.matching.features import reflected, shape_features
from esd.mesh.geometry import surface_area
from esd.mesh.mesh import Mesh, PointCloud
from esd.mesh.repair.repair import repair
from esd.nearest import nearest

MODEL = load_model("default")


def test_features_of_the_mirror_image_are_those_of_a_mirrored_file(blob):
    features = shape_features(repair(blob), model=MODEL)
    mirrored = Mesh(blob.vertices * [-1, 1, 1], blob.faces[:, ::-1])
    there = shape_features(repair(mirrored), model=MODEL)
    found = reflected(features, model=MODEL)
    # eigenvectors of the two solutions differ by rounding, and odd values by their signs
    np.testing.assert_allclose(found.values, there.values, atol=0.02 * np.abs(there.values).max())
    np.testing.assert_allclose(found.shape.vertices, mirrored.vertices)
    assert not np.allclose(found.embedded, features.embedded, atol=0.1)
    np.testing.assert_array_equal(reflected(found, model=MODEL).values, features.values)


@pytest.mark.usefixtures("subdivided")
def test_a_copy_is_mirrored_with_its_shape(blob):
    features = shape_features(repair(blob), model=MODEL, resample=True)
    found = reflected(features, model=MODEL)
    np.testing.assert_allclose(found.copy.vertices, features.copy.vertices * [-1, 1, 1])
    corners = found.copy.mesh.vertices[found.copy.mesh.faces[found.copy.points.face]]
    where = np.einsum("ij,ijk->ik", found.copy.points.weights, corners)
    np.testing.assert_allclose(where, blob.vertices * [-1, 1, 1], atol=1e-9)


def test_models_of_surfaces_embed_the_mirror_image_as_a_mirrored_file(blob):
    torch_layers = pytest.importorskip(
        "esd.learning.diffusion_torch", reason="training needs the extra `train`"
    )
    layers = torch_layers.seeded_layers(MODEL.recipe.width, 16, 8, 6, 2, seed=0)
    network = diffusion_network(layers.arrays(), inputs=MODEL.recipe.width)
    model = replace(MODEL, layers=(), diffusion=network)
    features = shape_features(repair(blob), model=model)
    found = reflected(features, model=model)
    mirrored = Mesh(blob.vertices * [-1, 1, 1], blob.faces[:, ::-1])
    surface = model.operator(mirrored, features.spectrum)
    np.testing.assert_array_equal(found.embedded, model.embed(found.values, surface))
    assert not np.allclose(found.embedded, features.embedded, atol=0.1)


def test_points_and_parts_have_no_mirror_image(blob):
    points = shape_features(repair(PointCloud(blob.vertices)), model=raw_model("hks"))
    with pytest.raises(InputError, match="Only meshes are mirrored"):
        reflected(points, model=raw_model("hks"))
    features = shape_features(repair(blob), model=MODEL)
    with pytest.raises(InputError, match="not by models with convolutions or parts"):
        reflected(features, model=load_model("partial"))


@pytest.mark.usefixtures("subdivided")
def test_small_meshes_are_subdivided_and_large_ones_have_coarse_copies(blob):
    repaired = repair(blob)
    plain = shape_features(repaired, model=raw_model("hks"))
    assert plain.copy is None
    assert plain.shape is repaired.shape
    fine = shape_features(repaired, model=raw_model("hks"), resample=True)
    assert len(fine.shape.vertices) >= 2000
    assert fine.positions is fine.shape.vertices
    coarse = shape_features(repaired, model=raw_model("hks"), coarse=320)
    assert len(coarse.shape.vertices) == 320
    assert surface_area(coarse.shape) == pytest.approx(surface_area(blob), rel=0.1)
    # the vertex of the copy nearest to each original one
    located = coarse.located(np.array([3, 200]))
    gap = np.linalg.norm(coarse.shape.vertices[located] - blob.vertices[[3, 200]], axis=1)
    least = nearest(blob.vertices[[3, 200]], coarse.shape.vertices)[1]
    assert (gap <= 2 * least).all()


def test_vertices_that_are_left_out_have_no_place(blob):
    loose = Mesh(np.concatenate([blob.vertices, [[50.0, 0, 0]]]), blob.faces)
    features = shape_features(repair(loose), model=raw_model("hks"), resample=True)
    located = features.located(np.array([0, len(blob.vertices)]))
    assert located[0] >= 0
    assert located[1] == -1
    assert not features.is_filling().any()
