from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from damaged import joined
from esd.common import InputError
from esd.datasets.bodies import bodies
from esd.datasets.parts import Perturbed, part_of
from esd.learning.model import load_model
from esd.matching.features import Features, shape_features
from esd.matching.match import _fits, match
from esd.matching.parts import best_part_map, is_calibrated, open_mesh
from esd.mesh.geodesics import geodesic_graph
from esd.mesh.geometry import surface_area
from esd.mesh.mesh import Mesh
from esd.mesh.repair.repair import repair
from esd.mesh.shapes import icosphere
from esd.spectral.cache import default_cache

NEAR = 0.09  # 5 % of a body's diameter, in √area


@cache
def body(name: str) -> tuple[Mesh, np.ndarray]:
    shape = next(shape for shape in bodies(vertex_count=2500).shapes if shape.name == name)
    return shape.mesh(), shape.correspondence()


@cache
def cut() -> Perturbed:
    """A person of whom 35 % of the area is missing."""
    return part_of(body("s10_p01")[0], "cut of 35 %", seed=3)


def rotated(mesh: Mesh, seed: int) -> Mesh:
    return Mesh(mesh.vertices @ Rotation.random(rng=seed).as_matrix().T, mesh.faces)


def right(index: np.ndarray, source: np.ndarray, target: np.ndarray, mesh: Mesh) -> float:
    """Share of points with a counterpart that are matched near it."""
    both = np.flatnonzero((source >= 0) & (target >= 0))[::40]
    distance = geodesic_graph(mesh).distances(target[both])
    there = index[source[both]]
    errors = np.where(there >= 0, distance[np.arange(len(both)), there], np.inf)
    return float((errors < NEAR * np.sqrt(surface_area(body("s11_p02")[0]))).mean())


def points_of_cut() -> np.ndarray:
    points = body("s10_p01")[1]
    return np.where(points >= 0, cut().vertex_index[points], -1)


def features(mesh: Mesh) -> Features:
    return shape_features(
        repair(mesh, restore=True), model=load_model("hks"), cache=default_cache()
    )


def test_a_part_is_matched_to_a_whole_of_another_person():
    whole, points = body("s11_p02")
    shapes = rotated(cut().mesh, 1), rotated(whole, 2)
    found = match(*shapes, candidates=["embedding", "part"], cache=default_cache())
    assert found.judgement.candidate == "part"
    assert found.judgement.verdict in ("good", "doubtful")  # 92 % are right: the meshes are coarse
    assert found.judgement.expected_accuracy > 0.8
    assert found.judgement.overlap.source > 0.95
    assert found.judgement.overlap.scale == pytest.approx(1, abs=0.25)  # people differ
    assert right(found.target_index, points_of_cut(), points, whole) > 0.9


def test_what_a_part_lacks_has_no_match_and_does_not_count():
    whole, points = body("s11_p02")
    found = match(
        rotated(whole, 1), rotated(cut().mesh, 2), candidates=["part"], cache=default_cache()
    )
    there = points_of_cut()
    has = there[points >= 0] >= 0
    matched = found.is_matched()[points[points >= 0]]
    assert matched[has].mean() > 0.8
    assert matched[~has].mean() < 0.1
    assert right(found.target_index, points, there, cut().mesh) > 0.8
    assert found.judgement.verdict != "failed"
    assert found.judgement.overlap.source == pytest.approx(has.mean(), abs=0.1)
    share = f"about {found.judgement.overlap.source:.0%} of the source has a counterpart"
    assert share in found.judgement.advice


def test_another_unit_of_length_is_found_unless_it_is_said_to_be_the_same():
    whole, points = body("s11_p02")
    larger = Mesh(1000 * cut().mesh.vertices, cut().mesh.faces)
    shapes = features(larger), features(whole)
    model = load_model("partial")
    found = best_part_map(*shapes, model=model, cache=default_cache())
    persons = np.sqrt(surface_area(body("s10_p01")[0]) / surface_area(whole))
    assert found.scale == pytest.approx(1000 * persons, rel=0.05)
    assert right(found.forward, points_of_cut(), points, whole) > 0.8
    assert best_part_map(*shapes, model=model, scale="same", cache=default_cache()).consistent < 0.3


def test_the_size_of_a_whole_is_found_about():
    larger = Mesh(1.055 * cut().mesh.vertices, cut().mesh.faces)
    shapes = features(larger), features(body("s10_p01")[0])
    found = best_part_map(*shapes, model=load_model("partial"), cache=default_cache())
    assert found.scale == pytest.approx(1.055, rel=0.03)


def test_landmarks_help_a_map_between_parts():
    points = points_of_cut()
    there = body("s11_p02")[1]
    chosen = np.flatnonzero((points >= 0) & (there >= 0))[::800]
    landmarks = np.stack([points[chosen], there[chosen]], axis=1)
    shapes = features(cut().mesh), features(body("s11_p02")[0])
    found = best_part_map(
        *shapes, model=load_model("partial"), landmarks=landmarks, cache=default_cache()
    )
    whole = body("s11_p02")[0]
    spacing = np.linalg.norm(
        whole.vertices[found.forward[landmarks[:, 0]]] - whole.vertices[landmarks[:, 1]], axis=1
    )
    assert np.median(spacing) < 0.05 * np.sqrt(surface_area(whole))


def test_a_model_of_whole_surfaces_is_not_taken_for_one_of_parts(monkeypatch):
    class DescribedError(Exception):
        pass

    def described(*_, model, **__):
        raise DescribedError(model)

    of_parts = load_model("partial")
    of_surfaces = replace(of_parts, recipe=load_model("default").recipe)
    monkeypatch.setattr("esd.matching.parts.part", described)
    opened = features(cut().mesh)
    for model in (of_parts, of_surfaces):
        with pytest.raises(DescribedError) as raised:
            best_part_map(opened, opened, model=model)
        assert raised.value.args[0].recipe.is_of_parts


def test_only_the_bundled_model_of_parts_is_calibrated():
    model = load_model("partial")
    assert is_calibrated(model) and is_calibrated(load_model("default"))
    weights = {name: 1.01 * values for name, values in model.diffusion.weights.items()}
    trained = replace(model, diffusion=replace(model.diffusion, weights=weights))
    assert not is_calibrated(trained)
    _, points = body("s10_p01")
    found = match(cut().mesh, body("s10_p01")[0], model=trained, candidates=["part"])
    assert right(found.target_index, points_of_cut(), points, body("s10_p01")[0]) > 0.9
    assert found.judgement.verdict == "doubtful"


@pytest.mark.parametrize(
    ("lost", "uncovered", "accuracy", "fits"),
    [(0.0, 0.01, 0.9, True), (0.02, 0.01, 0.9, False), (0.0, 0.01, 0.3, False)],
)
def test_a_map_fits_that_leaves_nothing_and_may_be_right(
    lost, uncovered, accuracy, fits, monkeypatch
):
    monkeypatch.setattr("esd.matching.match.accuracy", lambda evidence: accuracy)
    choice = SimpleNamespace(evidence=SimpleNamespace(lost=lost, uncovered=uncovered))
    assert _fits(choice) == fits


def test_closed_meshes_pinholes_and_several_pieces_are_no_parts():
    sphere = icosphere(4)
    assert open_mesh(features(sphere)) is None
    assert open_mesh(features(Mesh(sphere.vertices, sphere.faces[1:]))) is None
    half = Mesh(sphere.vertices, sphere.faces[sphere.vertices[sphere.faces, 2].mean(axis=1) > 0])
    opened = open_mesh(features(half))
    assert opened is not None
    assert surface_area(opened) == pytest.approx(surface_area(half))
    other = Mesh(half.vertices * [1, 1, -1.0], half.faces[:, ::-1])
    two = replace(features(half), shape=Mesh(*joined(half, other)))
    assert open_mesh(two) is None
    whole = features(sphere)
    assert best_part_map(whole, whole, model=load_model("partial")) is None


def test_what_fills_holes_is_no_part_of_an_open_mesh():
    whole = body("s10_p01")[0]
    arm = part_of(whole, "balls, medium", seed=0).mesh
    described = features(arm)
    opened = open_mesh(described)
    assert described.filling > 0
    assert opened is not None
    assert surface_area(opened) == pytest.approx(surface_area(arm), rel=0.02)


def test_the_candidate_alone_needs_an_open_mesh(blob):
    with pytest.raises(InputError, match="'part' needs a mesh with a cut or large holes"):
        match(blob, blob, candidates=["part"])
