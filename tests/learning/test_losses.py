import numpy as np
import pytest

from esd.learning.losses import contrastive_loss, infonce_loss, pair_criteria

torch = pytest.importorskip("torch", reason="training needs the extra `train`")


def test_loss_is_the_paper_s():
    squared = np.array([2.0, 2.0, 6.0, 2.0])
    label = np.array([1.0, 0.0, 0.0, 0.2])
    np.testing.assert_allclose(
        contrastive_loss(squared, label, margin=5.0), [2, 3, 0, 0.2 * 2 + 0.8 * 3]
    )
    criteria = pair_criteria(
        np.array([1.0, 3.0, 1.0, 3.0, 4.0, 4.0]), np.array([1, 1, 0, 0, 0, 0.1]), margin=5.0
    )
    assert criteria.miss_rate == 0.5
    assert criteria.false_match_rate == 0.25
    assert criteria.error_rate == 0.75
    assert criteria.loss_mean == pytest.approx(criteria.loss_sum / 6)


def test_infonce_is_the_cross_entropy_of_finding_the_match():
    generator = torch.Generator().manual_seed(0)
    source, target = (
        torch.nn.functional.normalize(torch.randn(7, 4, generator=generator), dim=1)
        for _ in range(2)
    )
    truth = torch.arange(7)
    both = [
        torch.nn.functional.cross_entropy(a @ b.T / 0.1, truth, reduction="none")
        for a, b in ((source, target), (target, source))
    ]
    found = infonce_loss(source, target, temperature=0.1)
    torch.testing.assert_close(found, sum(both) / 2)


def test_points_near_each_other_are_no_negatives():
    source, target = torch.eye(3), torch.eye(3)[[0, 2, 1]]
    near = torch.tensor([[0, 0, 0], [0, 0, 1], [0, 1, 0]], dtype=torch.bool)
    loss = infonce_loss(source, target, temperature=0.5, ignored=near)
    e = np.exp
    # of the second two, whose match is the other's place, only the first is a negative
    np.testing.assert_allclose(loss, np.log([1 + 2 * e(-2), 1 + 1, 1 + 1]), rtol=1e-6)
