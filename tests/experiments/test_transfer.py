from dataclasses import replace

import pytest

from esd.common import InputError
from esd.experiments import (
    table1,
    transfer,
)

pytest.importorskip("torch", reason="training needs the extra `train`")


def drawn(figures, folder):
    for name, figure in figures.items():
        figure.savefig(folder / f"{name}.png")
        assert (folder / f"{name}.png").stat().st_size > 5000
    return set(figures)


def test_transfer_is_a_matrix(made, tmp_path):
    def renamed(collection):
        return replace(collection, name="other")

    other = replace(made, training=renamed(made.testing), testing=renamed(made.training))
    outcome = transfer.run(made, other)
    assert outcome.collections == ("bent", "other")
    assert len(outcome.shares) == 3 * 3 * 2
    assert outcome.shares["hks", "bent", "bent"] == pytest.approx(
        100 * table1.run(made).matched[4].shares.mean()
    )
    assert drawn(transfer.figures(outcome), tmp_path) == {"transfer"}
    with pytest.raises(InputError, match="must have different names; got bent, bent"):
        transfer.run(made, made)
