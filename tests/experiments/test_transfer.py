from dataclasses import replace

import pytest

from esd.common import InputError
from esd.experiments import table1, transfer


def test_transfer_is_a_matrix(made, drawn):
    def renamed(collection):
        return replace(collection, name="other")

    other = replace(made, training=renamed(made.testing), testing=renamed(made.training))
    outcome = transfer.run(made, other)
    assert outcome.collections == ("bent", "other")
    assert len(outcome.shares) == 3 * 3 * 2
    assert outcome.shares["hks", "bent", "bent"] == pytest.approx(
        100 * table1.run(made).matched[4].shares.mean()
    )
    assert drawn(transfer.figures(outcome)) == {"transfer"}
    with pytest.raises(InputError, match="must have different names; got bent, bent"):
        transfer.run(made, made)
