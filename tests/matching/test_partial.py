from dataclasses import replace

import numpy as np
import pytest

from esd.datasets.bodies import bodies
from esd.learning.model import load_model
from esd.matching.partial import Part, consistent_share, part, part_map, refined_part_map
from esd.mesh.geometry import surface_area
from esd.mesh.mesh import Mesh


@pytest.fixture(scope="module")
def whole() -> Part:
    mesh = bodies().shapes[103].mesh()
    return part(mesh, surface_area(mesh), model=load_model("partial"))


def test_a_shape_is_mapped_to_itself_and_all_of_that_is_consistent(whole):
    found = refined_part_map(part_map(whole, whole))
    assert (found.forward == np.arange(len(whole.points))).mean() > 0.99
    assert found.consistent > 0.99
    assert found.scale == pytest.approx(1)
    has_counterpart, right = found.probabilities()
    assert has_counterpart.mean() > 0.9
    assert right.mean() > 0.9


def test_maps_that_do_not_return_or_turn_faces_over_are_not_consistent(whole):
    same = np.arange(len(whole.points))
    shuffled = np.random.default_rng(0).permutation(same)
    assert consistent_share(whole, whole, same, same) == pytest.approx(1)
    assert consistent_share(whole, whole, same, shuffled) < 0.01
    assert consistent_share(whole, whole, shuffled, np.argsort(shuffled)) < 0.01
    mirrored = Mesh(whole.mesh.vertices, whole.mesh.faces[:, ::-1])
    other = replace(whole, mesh=mirrored)
    assert consistent_share(whole, other, same, same) == 0


def test_the_share_of_the_whole_is_that_of_the_area():
    mesh = bodies().shapes[103].mesh()
    half = part(mesh, 2 * surface_area(mesh), model=load_model("partial"))
    assert half.spectrum.area == pytest.approx(0.5)
    length = np.linalg.norm(np.ptp(mesh.vertices, axis=0))
    expected = length / np.sqrt(2 * surface_area(mesh))
    assert np.linalg.norm(np.ptp(half.points, axis=0)) == pytest.approx(expected)
    assert np.linalg.norm(half.embedded, axis=1) == pytest.approx(1, abs=1e-5)


def test_a_part_at_another_size_is_what_it_is_when_computed_anew():
    mesh, model = bodies().shapes[103].mesh(), load_model("partial")
    area = surface_area(mesh)
    first = part(mesh, area, model=model)
    known, anew = part(mesh, 2 * area, model=model, known=first), part(mesh, 2 * area, model=model)
    np.testing.assert_array_equal(known.sample, anew.sample)
    # distances are rounded to 32 bits
    np.testing.assert_allclose(known.ways, anew.ways, rtol=1e-5)
    np.testing.assert_allclose(known.embedded, anew.embedded, atol=1e-4)
    assert known.ways.max() == pytest.approx(first.ways.max() / np.sqrt(2), rel=1e-5)


def test_the_anchors_of_a_shape_and_itself_are_equal(whole):
    found = part_map(whole, whole).anchors
    here, there = whole.sample[found.source], whole.sample[found.target]
    away = np.linalg.norm(whole.points[here] - whole.points[there], axis=1)
    assert np.median(away) == 0
    assert found.agreement > 0.9
    assert found.enlargement == pytest.approx(1, abs=1e-3)
