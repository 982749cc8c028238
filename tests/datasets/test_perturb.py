import numpy as np
import pytest

from esd.common import InputError
from esd.datasets.perturb import (
    PERTURBATIONS,
    edge_flips,
    geometric_noise,
    holes,
    plane_cut,
    short_circuits,
)
from esd.mesh.geometry import edge_lengths, is_referenced, surface_area
from esd.mesh.mesh import Mesh
from esd.mesh.repair.diagnose import diagnose
from esd.mesh.shapes import icosphere

SPHERE = icosphere(4)


@pytest.mark.parametrize("name", PERTURBATIONS)
def test_levels_rise_are_repeatable_and_keep_an_exact_index(blob, name):
    kind = PERTURBATIONS[name]
    assert sorted(kind.levels) == list(kind.levels)
    for level in (kind.levels[0], kind.levels[-1]):
        first, again = (kind.disturb(blob, level, seed=3) for _ in range(2))
        np.testing.assert_array_equal(first.mesh.vertices, again.mesh.vertices)
        assert is_referenced(first.mesh).all()
        kept = first.vertex_index >= 0
        reached = np.unique(first.vertex_index[kept])
        np.testing.assert_array_equal(reached, np.arange(len(first.mesh.vertices)))
        if name in ("holes", "flips", "cut"):
            np.testing.assert_array_equal(
                first.mesh.vertices[first.vertex_index[kept]], blob.vertices[kept]
            )


def test_level_zero_changes_nothing(blob):
    for kind in PERTURBATIONS.values():
        result = kind.disturb(blob, 0)
        np.testing.assert_array_equal(result.mesh.vertices, blob.vertices)
        np.testing.assert_array_equal(result.mesh.faces, blob.faces)


def test_noise_has_the_spread_it_says():
    moved = geometric_noise(SPHERE, 0.5).mesh.vertices
    step = np.linalg.norm(moved, axis=1) - 1
    # of 2,562 draws; the standard deviation of their deviation is 1.4 %
    assert step.std() == pytest.approx(0.5 * edge_lengths(SPHERE).mean(), rel=0.06)


def test_shares_are_those_asked_for():
    area = surface_area(SPHERE)
    cut = plane_cut(SPHERE, 0.3)
    assert surface_area(cut.mesh) == pytest.approx(0.7 * area, rel=0.01)  # a row of faces
    pierced = surface_area(holes(SPHERE, 0.2).mesh)
    assert 0.8 * area - 0.01 < pierced < 0.95 * area  # discs may overlap
    turned = edge_flips(SPHERE, 0.2).mesh
    assert diagnose(turned, thorough=False).findings == ()
    kept = {frozenset(face) for face in SPHERE.faces.tolist()}
    changed = sum(frozenset(face) not in kept for face in turned.faces.tolist())
    assert changed == pytest.approx(0.2 * len(SPHERE.faces), abs=2)


def test_short_circuits_join_what_is_far_along_the_surface(blob):
    result = short_circuits(blob, 0.05)
    welded = np.bincount(result.vertex_index) == 2
    assert welded.any()
    kinds = {finding.kind for finding in diagnose(result.mesh, thorough=False).findings}
    assert {"non_manifold_vertices", "non_manifold_edges"} & kinds
    small = icosphere(0)  # no path along it is a third of √area, once it is a single face
    with pytest.raises(InputError, match="No two parts of this mesh are far"):
        short_circuits(Mesh(small.vertices, np.repeat(small.faces[:1], 30, axis=0)), 0.1)


@pytest.mark.parametrize("disturb", [holes, edge_flips, short_circuits, plane_cut])
def test_impossible_levels_are_refused(blob, disturb):
    for level in (-0.1, 1.0):
        with pytest.raises(InputError, match="`level` must be from 0 to below 1"):
            disturb(blob, level)
    with pytest.raises(InputError, match="`level` must be from 0"):
        geometric_noise(blob, -1)
