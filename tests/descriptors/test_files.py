import h5py
import numpy as np
import pytest

from esd.common import InputError
from esd.descriptors.files import save_descriptor


@pytest.mark.parametrize("suffix", ["npy", "npz", "h5", "csv"])
def test_descriptors_come_back(tmp_path, suffix):
    values = np.random.default_rng(0).standard_normal((5, 3))
    path = tmp_path / f"d.{suffix}"
    save_descriptor(values, path)
    if suffix == "h5":
        with h5py.File(path) as store:
            back = store["descriptors"][:]
    elif suffix == "csv":
        back = np.loadtxt(path, delimiter=",")
    else:
        back = np.load(path, allow_pickle=False)
        back = back if suffix == "npy" else back["descriptors"]
    np.testing.assert_allclose(back, values, rtol=1e-8)  # text has nine digits


def test_other_files_are_refused(tmp_path):
    with pytest.raises(InputError, match="descriptors are written to"):
        save_descriptor(np.zeros((1, 1)), tmp_path / "d.txt")
