from dataclasses import replace

import numpy as np
import pytest

from esd.datasets.bodies import bodies
from esd.datasets.parts import part_of
from esd.learning.model import load_model
from esd.matching.part_registration import best_registered
from esd.matching.partial import PartMap, other_part_maps, part, part_map
from esd.mesh.geometry import surface_area
from esd.mesh.mesh import Mesh


@pytest.fixture(scope="module")
def found() -> PartMap:
    """The map from a part of a person to the whole of that person."""
    mesh = next(s for s in bodies(vertex_count=2500).shapes if s.name == "s10_p01").mesh()
    cut = part_of(mesh, "cut of 35 %", seed=2).mesh
    area, model = surface_area(mesh), load_model("partial")
    return part_map(part(cut, area, model=model), part(mesh, area, model=model))


def off(found: PartMap) -> float:
    """Mean distance of the images from where the vertices are on the whole."""
    return float(
        np.linalg.norm(found.target.points[found.forward] - found.source.points, axis=1).mean()
    )


def test_the_whole_is_deformed_onto_its_part_and_what_is_missing_does_not_lie_on_it(found):
    best = best_registered([found])
    assert off(best) < 0.01
    assert not best.fit.of_source
    assert best.fit.enlargement == pytest.approx(1, abs=0.02)
    assert np.median(best.fit.gap[0]) < 0.01
    missing = np.setdiff1d(np.arange(len(best.backward)), best.forward)
    assert np.median(best.fit.gap[1][missing]) > 0.03
    assert best.scale == pytest.approx(1, abs=0.02)


def test_what_the_other_lacks_is_told_from_what_it_has():
    mesh = next(s for s in bodies(vertex_count=2500).shapes if s.name == "s10_p01").mesh()
    cut = part_of(mesh, "cut of 35 %", seed=2)
    area, model = surface_area(mesh), load_model("partial")
    found = part_map(part(mesh, area, model=model), part(cut.mesh, area, model=model))
    has_counterpart, right = best_registered([found]).probabilities()
    is_shared = cut.vertex_index >= 0
    kept = has_counterpart > 0.5
    assert (kept & is_shared).sum() > 0.93 * (kept | is_shared).sum()
    assert right[kept & is_shared].mean() > 0.9


def test_maps_that_are_little_alike_or_have_a_close_rival_or_a_small_target_are_doubtful(found):
    best = best_registered([found])
    assert best.probabilities()[1].max() > 0.9
    target = best.target
    unlike = np.random.default_rng(0).permutation(target.embedded)
    for other in (replace(target, embedded=unlike), replace(target, ways=0.5 * target.ways)):
        assert replace(best, target=other).probabilities()[1].max() < 0.9
    close = replace(best, fit=replace(best.fit, margin=0.14))
    assert close.probabilities()[1].max() < 0.9


def test_a_map_that_is_turned_is_replaced_by_another(found):
    turned = other_part_maps([found], count=1)[0]
    assert off(turned) > 0.2
    best = best_registered([turned])
    assert off(best) < 0.02
    assert best.fit.margin > 0.1


def test_other_anchors_lead_away_from_the_first_and_those_among_halves_need_not(found):
    away, *halves = other_part_maps([found], count=7)
    there = found.target.sample
    used = away.anchors.support > 0.6
    gap = (
        found.target.points[there[away.anchors.target]]
        - found.target.points[there[found.anchors.target]]
    )
    assert np.linalg.norm(gap, axis=1)[used].min() > 0.05  # 0.15 along the surface
    assert len(halves) <= 6
    there_of = [each.target.points[there[each.anchors.target]] for each in (found, *halves)]
    for number, one in enumerate(there_of):
        assert all(np.linalg.norm(one - two, axis=1).mean() > 0.02 for two in there_of[:number])


def test_other_anchors_are_sought_at_each_size(found):
    area, model = 2 * surface_area(found.target.mesh), load_model("partial")
    smaller = part_map(part(found.source.mesh, area, model=model), found.target)
    others = other_part_maps([smaller, found], count=4)
    assert others[0].source is smaller.source
    assert {id(each.source) for each in others[1:]} == {id(smaller.source), id(found.source)}
    assert off(best_registered([smaller, found])) < 0.01


def test_surfaces_that_are_no_manifolds_are_not_deformed(found):
    faces = found.target.mesh.faces
    third = [[faces[0, 0], faces[0, 1], faces[-1, 2]]] * 2  # at an edge that has two faces already
    torn = replace(found.target, mesh=Mesh(found.target.mesh.vertices, np.vstack([faces, third])))
    assert best_registered([replace(found, target=torn)]) is None
