import numpy as np
import pytest

from esd.common import InputError

torch = pytest.importorskip("torch", reason="training needs the extra `train`")
from esd.learning.network import seeded_network  # noqa: E402
from esd.learning.optimise import adam_with_moments, descend  # noqa: E402
from esd.learning.run import Run, first_run, weights_of  # noqa: E402


def started() -> Run:
    network = seeded_network([3, 4, 2], 0)
    return first_run(network, adam_with_moments(network, rate=1e-2))


def advance(run: Run, steps: int) -> None:
    values = torch.from_numpy(np.random.default_rng(0).standard_normal((8, 3)).astype(np.float32))
    for _ in range(steps):
        descend(run.optimiser, (run.network(values) ** 2).mean(), rate=1e-2)
        run.step += 1


def test_the_weights_of_the_lowest_loss_are_kept_as_they_were():
    run = started()
    first = weights_of(run.network)
    for kept, weight in zip(run.best_weights, first, strict=True):
        assert torch.equal(kept, weight)
    advance(run, 3)
    run.note(0.5)
    best = weights_of(run.network)
    assert (run.best_loss, run.best_step) == (0.5, 3)
    assert not torch.equal(best[0], first[0])
    advance(run, 2)  # copies do not change with the network
    run.note(0.7)
    assert (run.best_loss, run.best_step) == (0.5, 3)
    assert torch.equal(run.best_weights[0], best[0])
    assert not torch.equal(run.best_weights[0], weights_of(run.network)[0])


def test_a_training_is_exhausted_after_ten_validations_that_are_no_better():
    run = started()
    run.step, run.best_step = 119, 20
    assert not run.is_exhausted(10)
    run.step = 120
    assert run.is_exhausted(10)


def test_a_resumed_run_takes_the_same_steps(tmp_path):
    run = started()
    advance(run, 4)
    run.note(0.25)
    run.curve.append((4, 0.5, 0.25))
    run.save(tmp_path / "c", identity="this")
    advance(run, 5)
    resumed = started()
    resumed.resume(tmp_path / "c", identity="this")
    assert (resumed.step, resumed.best_loss, resumed.best_step) == (4, 0.25, 4)
    assert [tuple(row) for row in resumed.curve] == [(4, 0.5, 0.25)]
    advance(resumed, 5)
    for weight, again in zip(weights_of(run.network), weights_of(resumed.network), strict=True):
        assert torch.equal(weight, again)
    with pytest.raises(InputError, match="belongs to another training"):
        started().resume(tmp_path / "c", identity="other")
