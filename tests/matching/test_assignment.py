import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment

from esd.common import InputError
from esd.matching.assignment import one_to_one


def test_assignments_cost_as_little_as_a_dense_solver_s():
    generator = np.random.default_rng(0)
    source, target = generator.standard_normal((40, 3)), generator.standard_normal((60, 3))
    index = one_to_one(source, target, candidates=60)
    assert len(set(index)) == 40
    squares = ((source[:, None] - target) ** 2).sum(axis=2)
    assert squares[np.arange(40), index].sum() == pytest.approx(
        squares[linear_sum_assignment(squares)].sum()
    )


def test_what_finds_no_place_is_left_out():
    target = np.eye(3)
    index = one_to_one(np.concatenate([target, target * 1.1, [[np.nan] * 3]]), target)
    assert sorted(index) == [-1, -1, -1, -1, 0, 1, 2]
    assert index[6] == -1
    with pytest.raises(InputError, match="equally long"):
        one_to_one(np.zeros((3, 2)), np.zeros((3, 3)))
    with pytest.raises(InputError, match="No vertex has a finite row"):
        one_to_one(np.full((3, 2), np.nan), np.zeros((3, 2)))
