import numpy as np
import pytest

from esd.common import InputError
from esd.nearest import nearest


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
