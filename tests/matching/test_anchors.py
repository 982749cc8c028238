import numpy as np
import pytest
from scipy.spatial.distance import cdist

from esd.matching.anchors import agreement, agreement_with_most, anchors, nearness


def plane(count: int, seed: int) -> np.ndarray:
    """Points of a square, whose distances are known."""
    return np.random.default_rng(seed).uniform(0, 0.7, size=(count, 2))


def test_distances_decide_between_candidates_that_look_alike():
    points = plane(60, 0)
    order = np.random.default_rng(1).permutation(60)
    target = points[order]
    truth = np.argsort(order)
    similarity = np.zeros((60, 60))
    similarity[np.arange(60), truth] = 0.9
    other = (truth + 30) % 60  # looks a little more alike for a third of the points
    similarity[np.arange(0, 60, 3), other[::3]] = 0.95
    assert (similarity.argmax(axis=1) == truth).mean() == pytest.approx(2 / 3)
    found = anchors(similarity, cdist(points, points), cdist(target, target))
    near = np.linalg.norm(target[found.target] - points, axis=1) < 0.1
    assert near.mean() > 0.95
    assert found.enlargement == pytest.approx(1, abs=0.01)
    np.testing.assert_array_equal(found.source, np.arange(60))


def test_what_has_no_counterpart_has_less_support():
    points = plane(80, 2)
    target = points[:50]
    similarity = np.random.default_rng(3).uniform(0, 0.1, size=(80, 50))
    similarity[np.arange(50), np.arange(50)] = 0.9
    found = anchors(similarity, cdist(points, points), cdist(target, target))
    assert found.support[:50].mean() > 1.5 * found.support[50:].mean()


def test_the_enlargement_is_that_of_distances():
    points = plane(60, 4)
    ways = cdist(points, points)
    found = anchors(np.eye(60), ways, 1.06 * ways)
    assert found.enlargement == pytest.approx(1.06, abs=0.01)
    assert found.agreement < anchors(np.eye(60), ways, ways).agreement


def test_points_of_a_limb_that_is_mapped_elsewhere_do_not_agree():
    points = plane(200, 5)
    image = points.copy()
    limb = points[:, 0] > 0.5
    image[limb, 1] += 0.6  # smoothly, but to where it does not belong
    places = np.arange(0, 200, 4)
    kept = agreement(cdist(points[places], points), cdist(image[places], image), places)
    assert kept[~limb].min() > kept[limb].max()
    assert kept.max() == 1


def test_what_is_mapped_elsewhere_does_not_support_itself_and_lengths_may_differ():
    points = plane(200, 5)
    image = 1.1 * points
    limb = points[:, 0] > 0.6
    image[limb, 1] += 0.6
    places = np.arange(0, 200, 4)
    ways = cdist(points[places], points), cdist(image[places], image)
    kept, share = agreement_with_most(*ways, places, np.ones(50, dtype=bool))
    assert kept[~limb].min() > 0.9
    assert share == pytest.approx(1 - limb[places].mean(), abs=0.1)
    assert kept[limb].max() < 0.8


def test_distances_on_a_part_may_be_longer():
    points = plane(200, 7)
    places = np.arange(0, 200, 4)
    ways = cdist(points[places], points)
    around = ways + 0.1 * (points[places, None, 0] > 0.5) * (points[:, 0] < 0.5)
    everywhere = np.ones(50, dtype=bool)
    kept, slack = (
        agreement_with_most(ways, around, places, everywhere, slack=(1.0, factor))[0]
        for factor in (1.0, 3.0)
    )
    assert slack.min() > kept.min()


def test_rows_are_of_unit_length_and_lead_to_the_same_place():
    points = plane(50, 6)
    rows = nearness(cdist(points[:20], points))
    np.testing.assert_allclose(np.linalg.norm(rows, axis=1), 1)
    np.testing.assert_array_equal((rows @ rows.T).argmax(axis=1), np.arange(50))
