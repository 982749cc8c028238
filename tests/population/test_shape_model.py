from functools import cache

import numpy as np
import pytest

import esd
from esd.common import InputError
from esd.mesh.geometry import vertex_areas
from esd.mesh.shapes import icosphere
from esd.population.procrustes import generalised_procrustes
from esd.population.shape_model import (
    ShapeModel,
    load_shape_model,
    principal_components,
    save_shape_model,
    without_missing,
)

SPHERE = icosphere(2)
MASS = vertex_areas(SPHERE) / vertex_areas(SPHERE).sum()
DIRECTIONS = np.stack(
    [SPHERE.vertices * [1.0, 0, 0], SPHERE.vertices[:, [1, 0, 2]] * SPHERE.vertices[:, 2:]]
)
TRUE = np.random.default_rng(0).normal(size=(12, 2)) * [0.3, 0.1]


def population() -> np.ndarray:
    """Spheres varied in two ways."""
    return SPHERE.vertices + np.tensordot(TRUE, DIRECTIONS, axes=1)


@cache
def aligned() -> ShapeModel:
    """The model of these, aligned: its modes hold no rotations."""
    found = generalised_procrustes(population(), mass=MASS, keep_size=True)
    return principal_components(
        found.vertices, SPHERE.faces, mass=MASS, count=2, keep_size=True
    ).model


@pytest.fixture
def model() -> ShapeModel:
    return principal_components(population(), SPHERE.faces, mass=MASS).model


def test_modes_are_orthonormal_and_the_variances_those_of_the_scores():
    found = principal_components(population(), SPHERE.faces, mass=MASS)
    modes = found.model.modes
    assert len(modes) == 2
    products = np.einsum("kvc,jvc,v->kj", modes, modes, MASS)
    assert products == pytest.approx(np.eye(2), abs=1e-9)
    assert np.cov(found.scores.T) == pytest.approx(np.diag(found.model.variances), abs=1e-12)
    assert found.model.explained()[-1] == pytest.approx(1.0)
    # the total variance is the mean over the surface of that of the positions
    variance = population().var(axis=0, ddof=1).sum(axis=1) @ MASS
    assert found.model.total_variance == pytest.approx(variance)
    assert found.model.deviation() ** 2 @ MASS == pytest.approx(variance)


def test_scores_reconstruct_the_shapes_and_shapes_have_the_scores():
    found = principal_components(population(), SPHERE.faces, mass=MASS)
    assert found.model.reconstructed(found.scores) == pytest.approx(population(), abs=1e-9)
    assert found.model.reconstructed([]) == pytest.approx(found.model.mean)
    turned = aligned().reconstructed([0.05, 0.02])[:, [1, 2, 0]] + np.array([3.0, 0, 0])
    # small variations are orthogonal to rotations, larger ones nearly
    assert aligned().scores(turned) == pytest.approx([0.05, 0.02], abs=1e-3)


def test_scores_of_a_part_are_those_of_the_whole():
    part = aligned().reconstructed([0.05, 0.02])
    part[SPHERE.vertices[:, 1] > 0.2] = np.nan
    # a part is aligned to that of the mean, which takes some of its variation for a motion
    assert aligned().scores(part) == pytest.approx([0.05, 0.02], abs=0.015)


def test_a_model_comes_back_from_its_file(model, tmp_path):
    esd.save_shape_model(model, tmp_path / "model.npz")
    again = esd.load_shape_model(tmp_path / "model.npz")
    for name in ("mean", "modes", "variances", "faces", "mass"):
        np.testing.assert_array_equal(getattr(again, name), getattr(model, name))
    assert (again.total_variance, again.keep_size) == (model.total_variance, model.keep_size)
    assert repr(again) == "<ShapeModel of 162 vertices: 2 modes, 100% of the variance>"


def test_what_is_no_model_is_refused(model, tmp_path):
    with pytest.raises(InputError, match=r"are written to \.npz files"):
        save_shape_model(model, tmp_path / "model.npy")
    with pytest.raises(InputError, match="There is no file"):
        load_shape_model(tmp_path / "model.npz")
    path = tmp_path / "other.npz"
    np.savez(path, mean=model.mean)
    with pytest.raises(InputError, match="no model of a population"):
        load_shape_model(path)
    arrays = {
        "mean": model.mean,
        "modes": model.modes,
        "variances": model.variances,
        "faces": model.faces,
        "mass": model.mass,
        "total_variance": 1.0,
        "keep_size": False,
    }
    np.savez(path, **{**arrays, "modes": model.modes[:, :5]})
    with pytest.raises(InputError, match=r"`modes` must have shape \(2, 162, 3\); got \(2, 5, 3\)"):
        load_shape_model(path)
    np.savez(path, **{**arrays, "faces": model.faces + 1})
    with pytest.raises(InputError, match="`faces` must hold vertices from 0 to 161"):
        load_shape_model(path)
    with pytest.raises(InputError, match=r"j up to 2, the number of modes; got \(3,\)"):
        model.reconstructed([1.0, 2.0, 3.0])
    with pytest.raises(InputError, match=r"`vertices` must have shape \(162, 3\); got \(5, 3\)"):
        model.scores(model.mean[:5])


def test_the_number_of_modes_may_be_limited():
    found = principal_components(population(), SPHERE.faces, mass=MASS, count=1)
    assert found.scores.shape == (12, 1)
    assert 0.5 < found.model.explained()[0] < 1.0


def test_a_mesh_without_what_is_missing():
    vertices = SPHERE.vertices.copy()
    vertices[SPHERE.faces[0, 0]] = np.nan
    mesh = without_missing(vertices, SPHERE.faces)
    assert len(mesh.vertices) == len(vertices)
    assert not (mesh.faces == SPHERE.faces[0, 0]).any()
