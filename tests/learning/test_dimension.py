import numpy as np
import pytest
from scipy.spatial import KDTree

from esd.common import InputError
from esd.learning.dimension import components_needed, nearest_neighbours, residual_variances


@pytest.fixture
def generator():
    return np.random.default_rng(0)


def test_a_flat_of_three_dimensions_needs_three_components(generator):
    values = generator.uniform(size=(500, 3)) @ generator.standard_normal((3, 20)) + 5
    near = nearest_neighbours(values, np.arange(100), count=12)
    residuals = residual_variances(values, near)
    assert residuals.shape == (100, 12)
    np.testing.assert_array_equal(residuals[:, 0], 1)
    assert (residuals[:, 3:] < 1e-10).all()
    assert (components_needed(residuals, share=1 - 1e-9) == 3).all()
    assert (np.diff(residuals, axis=1) <= 1e-12).all()


@pytest.mark.parametrize("k", [6, 15])
def test_neighbours_of_noise_span_as_much_as_they_can(generator, k):
    values = generator.standard_normal((2000, 100))
    near = nearest_neighbours(values, np.arange(50), count=k)
    assert (components_needed(residual_variances(values, near)) == k - 1).all()


def test_neighbours_are_the_nearest_and_not_the_point_itself(generator):
    values = generator.standard_normal((300, 4)) + 100
    places = np.array([5, 17, 299])
    _, expected = KDTree(values).query(values[places], k=8)
    np.testing.assert_array_equal(nearest_neighbours(values, places, count=7), expected[:, 1:])


def test_equal_points_need_no_component():
    residuals = residual_variances(np.ones((9, 3)), np.arange(8)[None])
    assert np.isfinite(residuals).all()


def test_more_neighbours_than_rows_are_refused(generator):
    with pytest.raises(InputError, match="`count` must be from 1 to 4; got 5"):
        nearest_neighbours(np.ones((5, 2)), np.array([0]), count=5)
