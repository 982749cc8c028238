from dataclasses import replace

import h5py
import numpy as np
import pytest

from bent import RECIPE, bent_shapes
from esd.common import InputError
from esd.datasets.collection import Collection
from esd.datasets.precompute import precompute
from esd.datasets.store import is_store, open_store
from esd.parallel import Workers


@pytest.fixture
def collection() -> Collection:
    """Shapes in an order that is not that of their names."""
    return bent_shapes((2, 0, 1))


def test_stores_of_something_else_are_refused(collection, tmp_path):
    (tmp_path / "data.hdf5").write_bytes(b"the user's own")
    with pytest.raises(InputError, match="is no store of descriptors and is not replaced"):
        precompute(collection, RECIPE, tmp_path / "data.hdf5", renew=True)
    assert (tmp_path / "data.hdf5").read_bytes() == b"the user's own"
    path = tmp_path / "s.h5"
    precompute(collection, RECIPE, path, workers=Workers(1))
    with pytest.raises(InputError, match="of another recipe"):
        precompute(collection, replace(RECIPE, eigenpairs=16), path)
    with pytest.raises(InputError, match="holds shapes of 'bent', not of 'x'"):
        precompute(replace(collection, name="x"), RECIPE, path)
    with pytest.raises(InputError, match="cannot be written to"):
        precompute(collection, RECIPE, path / "s.h5")
    whole = path.read_bytes()
    with h5py.File(path, "a") as file:
        del file["rows"]
    with pytest.raises(InputError, match="is damaged; make it anew"):
        open_store(path)
    path.write_bytes(whole)
    with h5py.File(path, "a") as file:
        file["vertex_start"][1] = 10**6
    with pytest.raises(InputError, match="its parts do not fit"):
        open_store(path)
    path.write_bytes(whole)
    with h5py.File(path, "a") as file:
        file["rows"][0] = 10**6
    with pytest.raises(InputError, match=r"points of '.*' are at rows that it does not have"):
        open_store(path).read(0)
    path.write_bytes(whole)
    with h5py.File(path, "a") as file:
        del file["mean"]
        file["mean"] = np.zeros((3, 11), dtype="f4")
    with pytest.raises(InputError, match="'/mean' is not as it was written"):
        open_store(path)
    path.write_bytes(whole[:500])
    assert not is_store(path)
    with pytest.raises(InputError, match="is no store of descriptors"):
        open_store(path)


def test_a_file_whose_root_is_damaged_is_no_store(tmp_path):
    path = tmp_path / "a.h5"
    with h5py.File(path, "w", libver="latest") as file:
        file.attrs["format"] = "esd-descriptors-1"
    assert is_store(path)
    whole = path.read_bytes()
    at = whole.index(b"OHDR")  # of the root, which its checksum guards
    path.write_bytes(whole[: at + 5] + b"\xff" + whole[at + 6 :])
    assert not is_store(path)
