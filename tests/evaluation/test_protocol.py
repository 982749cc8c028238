from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from esd.common import InputError
from esd.datasets.collection import Shape
from esd.descriptors.recipe import Descriptor, Recipe
from esd.evaluation.protocol import (
    PairErrors,
    VerdictCount,
    confidence_bins,
    evaluate,
    randomly_rotated,
    verdict_counts,
)
from esd.learning.model import Model, load_model
from esd.mesh.geodesics import geodesic_diameter
from esd.mesh.geometry import surface_area
from esd.mesh.mesh import Mesh
from esd.nearest import nearest
from esd.parallel import Workers


@pytest.fixture
def model():
    recipe = Recipe((Descriptor("hks", 20, log=True),), eigenpairs=60)
    return Model("hks", recipe, np.zeros(20), np.ones(20), margin=4.0)


def _same(value):  # lambdas go to no other process
    return value


@pytest.fixture
def shapes(blob):
    """A shape, and itself twice as large with its vertices renumbered."""
    count = len(blob.vertices)
    order = np.random.default_rng(0).permutation(count)
    place = np.argsort(order)
    renumbered, truths = Mesh(2 * blob.vertices[order], place[blob.faces]), (place, place[::-1])
    return (
        Shape("a", "a", "t", partial(_same, blob), partial(np.arange, count)),
        Shape("b", "b", "t", partial(_same, renumbered), *(partial(_same, x) for x in truths)),
    )


def test_perfect_maps_have_perfect_figures(model, shapes):
    result, [pair] = evaluate(model, [shapes])
    assert result.accuracy_5pct_diameter > 0.99
    assert result.mean_geodesic_error_x100 < 1
    assert result.auc > 0.98
    assert result.coverage > 0.98
    assert (result.pairs, result.matched) == (1, 1.0)
    assert result.symmetric_mean_geodesic_error_x100 <= result.mean_geodesic_error_x100
    assert pair.diameter == pytest.approx(2 * geodesic_diameter(shapes[0].mesh()), rel=0.01)
    assert len(pair.errors) == len(shapes[0].mesh().vertices)


def test_figures_do_not_depend_on_the_number_of_processes(model, shapes):
    pairs = [shapes, shapes[::-1]]
    once = evaluate(model, pairs)[0]
    again = evaluate(model, pairs, workers=Workers(2))[0]
    assert replace(again, seconds=0) == replace(once, seconds=0)
    assert again.symmetric_mean_geodesic_error_x100 is None  # known for one shape only


def test_wrong_truth_shows_and_missing_points_do_not_count(model, shapes):
    source, target = shapes
    count = len(source.mesh().vertices)
    shifted = replace(
        target, correspondence=lambda: np.roll(target.correspondence(), 9), symmetric=None
    )
    wrong, _ = evaluate(model, [(source, shifted)])
    assert wrong.mean_geodesic_error_x100 > 10
    missing = np.where(np.arange(count) < 100, -1, np.arange(count))
    partial = replace(source, correspondence=lambda: missing)
    _, [pair] = evaluate(model, [(partial, target)])
    assert len(pair.errors) == count - 100
    assert np.isfinite(pair.errors).all()


def test_rejected_points_are_wrong_but_not_in_the_mean(model, shapes):
    # longer by a tenth, so that distances are more than rounding
    other = shapes[1].mesh()
    longer = Mesh(other.vertices * [1, 1, 1.1], other.faces)
    shapes = shapes[0], replace(shapes[1], mesh=partial(_same, longer))
    _, [pair] = evaluate(model, [shapes])
    _, distance = nearest(*(model.embed_mesh(shape.mesh()) for shape in shapes))
    strict = replace(model, margin=2 * float(np.median(distance)) ** 2)  # rejects half
    result, _ = evaluate(strict, [shapes], reject=True)
    assert result.matched == pytest.approx(0.5, abs=0.01)
    assert result.accuracy_5pct_diameter <= result.matched
    assert len(pair.errors) == len(distance)
    with pytest.raises(InputError, match="No vertex was matched"):
        evaluate(replace(model, margin=1e-30), [shapes], reject=True)
    with pytest.raises(InputError, match="no threshold"):
        evaluate(replace(model, margin=None), [shapes], reject=True)


def test_correspondences_beyond_the_mesh_are_refused(model, shapes):
    beyond = replace(shapes[1], correspondence=lambda: np.array([10**6]))
    with pytest.raises(InputError, match="'b' names vertex 1000000"):
        evaluate(model, [(shapes[0], beyond)])


def test_broken_meshes_are_evaluated_as_they_are_matched(blob):
    index = np.arange(len(blob.vertices))
    twice = Mesh(blob.vertices, np.concatenate([blob.faces, blob.faces[:5, [0, 2, 1]]]))
    whole, broken = (
        Shape(name, name, "t", lambda mesh=mesh: mesh, lambda: index)
        for name, mesh in (("a", blob), ("b", twice))
    )
    model = load_model("default")
    result, _ = evaluate(model, [(whole, broken)])
    assert result.mean_geodesic_error_x100 < 0.5


def test_errors_are_measured_on_the_surface_as_it_was(blob):
    far = np.linalg.norm(blob.vertices - blob.vertices[7], axis=1)
    hole = Mesh(blob.vertices, blob.faces[(far[blob.faces] > 0.3).all(axis=1)])
    index = np.where(np.isin(np.arange(len(far)), hole.faces), np.arange(len(far)), -1)
    whole = Shape("a", "a", "t", lambda: blob, lambda: np.arange(len(far)))
    pierced = Shape("b", "b", "t", lambda: hole, lambda: index)
    result, pairs = evaluate(load_model("default"), [(whole, pierced), (pierced, whole)])
    for pair, mesh in zip(pairs, (hole, blob), strict=True):
        assert len(pair.errors) == (index >= 0).sum()
        assert np.isfinite(pair.errors).all()
        assert pair.square_root_area == pytest.approx(surface_area(mesh) ** 0.5)
        assert pair.coverage <= 1
    assert result.mean_geodesic_error_x100 < 3


def test_two_shapes_of_one_name_are_refused(blob, model):
    index = np.arange(len(blob.vertices))
    source, target = (Shape("a", "s", "t", lambda: blob, lambda: index) for _ in range(2))
    with pytest.raises(InputError, match="Two different shapes are called 'a'"):
        evaluate(model, [(source, target)])


def measured(errors, *, confidence=None, lone=(), lone_matched=(), verdict=None, expected=None):
    """Errors on a target of diameter 2, within 0.1 of which a match is right."""
    errors = np.array(errors, dtype=float)
    return PairErrors(
        source="a",
        target="b",
        errors=errors,
        symmetric_errors=None,
        confidence=np.ones(len(errors)) if confidence is None else np.array(confidence),
        square_root_area=1.0,
        diameter=2.0,
        coverage=1.0,
        lone_confidence=np.array(lone, dtype=float),
        lone_matched=np.array(lone_matched, dtype=bool),
        verdict=verdict,
        expected_accuracy=expected,
    )


def test_overlap_of_a_known_map():
    # three of four points with a counterpart are matched, and one of two without
    pair = measured(
        [0, 0.05, 1, np.nan], confidence=[0.9, 0.6, 0.3, 0], lone=[0.5, 0], lone_matched=[1, 0]
    )
    assert pair.overlap_iou() == 3 / 5
    assert pair.overlap_balanced_accuracy() == (3 / 4 + 1 / 2) / 2
    # of eight comparisons: 0.3 loses against 0.5, 0 does so too and ties with 0
    assert pair.confidence_separation() == (8 - 2 - 0.5) / 8
    whole = measured([0, np.nan])
    assert whole.overlap_iou() == 1 / 2
    assert whole.overlap_balanced_accuracy() is whole.confidence_separation() is None


def test_verdicts_are_counted_with_the_share_that_is_right():
    pairs = [
        measured([0, 0, 0, 1], verdict="good", expected=0.8),
        measured([0, 0, 1, 1], verdict="good", expected=0.6, lone=[0.1], lone_matched=[1]),
        measured([1, np.nan], verdict="failed", expected=0.1),
        measured([0]),
    ]
    assert verdict_counts(pairs) == {
        "good": VerdictCount(2, pytest.approx(0.7), 0.625, 0.5),
        "failed": VerdictCount(1, 0.1, 0.0, 0.0),
    }


def test_bins_of_confidence_hold_all_matches_and_count_what_is_right():
    pair = measured([0, 1, 0, 0], confidence=[0.1, 0.1, 0.92, 1], lone=[0.93], lone_matched=[1])
    low, high, highest = confidence_bins([pair])
    assert (low.low, low.high, low.share, low.right) == (0, 0.2, 2 / 5, 1 / 2)
    assert (high.low, high.share, high.right) == (0.9, 2 / 5, 1 / 2)
    assert (highest.high, highest.share, highest.right, highest.confidence) == (1, 1 / 5, 1, 1)


def test_shapes_that_lack_points_have_an_overlap(model, shapes):
    source, target = shapes
    lacking = np.where(target.correspondence() < 100, -1, target.correspondence())
    result, [pair] = evaluate(model, [(source, replace(target, correspondence=lambda: lacking))])
    assert len(pair.lone_confidence) == len(pair.lone_matched) == 100
    assert len(pair.errors) == len(lacking) - 100
    # all vertices are matched, also the hundred without a counterpart
    assert result.overlap_iou == pytest.approx(1 - 100 / len(lacking))
    assert result.overlap_balanced_accuracy == 0.5
    assert 0 <= result.confidence_separation <= 1
    whole, _ = evaluate(model, [shapes])
    assert whole.overlap_iou is whole.overlap_balanced_accuracy is None


def test_rotated_shapes_have_the_same_errors(model, shapes):
    plain = evaluate(model, [shapes])[1][0]
    turned = evaluate(model, [shapes], rotate=3)[1][0]
    # descriptors do not see rotations, but for rounding, which may decide between equal neighbours
    assert (np.abs(plain.errors - turned.errors) < 1e-6).mean() > 0.95
    first, again, other = (randomly_rotated(shapes[0], seed=s).mesh().vertices for s in (3, 3, 4))
    np.testing.assert_array_equal(first, again)
    assert np.abs(first - other).max() > 0.1
    original = shapes[0].mesh().vertices
    np.testing.assert_allclose(first @ first.T, original @ original.T, atol=1e-12)  # a rotation
    turn = np.linalg.lstsq(original, first, rcond=None)[0]
    assert np.linalg.det(turn) == pytest.approx(1)  # and no reflection
