import numpy as np
import pytest

from esd.common import InputError
from esd.nearest import nearest, nearest_within


@pytest.mark.parametrize("width", [3, 100])  # by tree, by products
def test_nearest_is_the_nearest(width):
    generator = np.random.default_rng(0)
    source, target = (
        generator.standard_normal((70, width)) + 50,
        generator.standard_normal((90, width)) + 50,
    )
    every = np.linalg.norm(source[:, None] - target, axis=2)
    index, distance = nearest(source, target)
    np.testing.assert_array_equal(index, every.argmin(axis=1))
    np.testing.assert_allclose(distance, every.min(axis=1), rtol=1e-12)


def test_rows_that_are_not_finite_take_no_part():
    source = np.array([[0.0], [np.nan], [2.0]])
    target = np.array([[np.inf], [0.4], [1.9]])
    index, distance = nearest(source, target)
    np.testing.assert_array_equal(index, [1, -1, 2])
    assert np.isinf(distance[1])
    with pytest.raises(InputError, match="no vertex with a finite"):
        nearest(source, target[:1])
    with pytest.raises(InputError, match="equally long"):
        nearest(source, np.zeros((3, 2)))


def test_rows_within_reach_are_those_of_the_cells_that_a_group_may_go_to():
    generator = np.random.default_rng(0)
    source, target = generator.standard_normal((60, 4)), generator.standard_normal((80, 4))
    source[3], target[5] = np.nan, np.nan
    groups, cells = generator.integers(0, 3, 60), generator.integers(0, 6, 80)
    reach = [np.arange(6), np.array([1, 4]), np.zeros(0, dtype=int)]
    index, products = nearest_within(source, target, groups, cells, reach)
    everywhere, _ = nearest(source, target)
    np.testing.assert_array_equal(index[groups == 0], everywhere[groups == 0])
    some = (groups == 1) & (index >= 0)
    allowed = np.flatnonzero(np.isin(cells, reach[1]))
    np.testing.assert_array_equal(index[some], allowed[nearest(source[some], target[allowed])[0]])
    assert (index[groups == 2] == -1).all()
    assert index[3] == -1
    assert products < 60 * 80


def test_cells_without_rows_are_no_error_though_they_are_the_last():
    source, target = np.array([[0.0], [5.0]]), np.array([[0.0], [4.0], [5.0]])
    reach = [np.array([0, 2]), np.array([1, 3])]  # nothing is in cells 2 and 3
    index, products = nearest_within(source, target, np.array([0, 1]), np.array([0, 1, 1]), reach)
    np.testing.assert_array_equal(index, [0, 2])
    assert products == 3
    nothing, _ = nearest_within(
        source, target, np.array([0, 0]), np.array([0, 1, 1]), [reach[0][:0]]
    )
    np.testing.assert_array_equal(nothing, [-1, -1])
