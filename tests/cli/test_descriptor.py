import numpy as np
import pytest


@pytest.mark.parametrize(
    ("kind", "width"), [("hks", 100), ("gps", 25), ("sihks", 19), ("geometry", 150)]
)
def test_descriptors_are_written_as_numpy_arrays(run_here, shapes, kind, width):
    run_here("descriptor", "tr_reg_000.off", "--kind", kind, "-o", "d.npy", where=shapes)
    assert np.load(shapes / "d.npy").shape == (384, width)


def test_descriptors_are_written_as_text(run_here, shapes):
    run_here("descriptor", "tr_reg_000.off", "-o", "d.csv", where=shapes)
    assert len((shapes / "d.csv").read_text().splitlines()) == 384
