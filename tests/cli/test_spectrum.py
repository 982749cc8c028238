import numpy as np


def test_eigenpairs_are_written(run_here, shapes):
    run_here("spectrum", "tr_reg_000.off", "-k", 20, "-o", "s.npz", where=shapes)
    with np.load(shapes / "s.npz", allow_pickle=False) as file:
        assert file["eigenvalues"].shape == (20,)
    coarse = ("-k", 20, "--coarse", 350, "-o", "c.npz")
    run_here("spectrum", "tr_reg_000.off", *coarse, where=shapes)
    with np.load(shapes / "c.npz", allow_pickle=False) as file:
        assert file["eigenvectors"].shape == (384, 20)
