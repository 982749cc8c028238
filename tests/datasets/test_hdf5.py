"""HDF5 files that reach out for other files, or promise more than they hold."""

import h5py
import numpy as np
import pytest

from esd.common import InputError
from esd.datasets.dyna import dyna_collection
from esd.datasets.hdf5 import check_self_contained
from esd.datasets.store import open_store

NAME = "50002_hips"


def link(file, secret):
    file[NAME] = h5py.ExternalLink(str(secret), "/x")


def soft_link(file, secret):
    file.create_group("g")["out"] = h5py.ExternalLink(str(secret), "/")
    file[NAME] = h5py.SoftLink("/g/out/x")


def raw_data(file, secret):
    file.create_dataset(NAME, (4, 3, 2), "u1", external=[(str(secret), 0, 24)])


def virtual(file, secret):
    layout = h5py.VirtualLayout((4, 3, 2), "f4")
    layout[:] = h5py.VirtualSource(str(secret), "x", (4, 3, 2))
    file.create_virtual_dataset(NAME, layout)


def bomb(file, secret):
    file.create_dataset(NAME, (10**9, 3, 2), "f4", chunks=(1000, 3, 1), compression="gzip")


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (link, f"'{NAME}' is a link"),
        (soft_link, f"'{NAME}' is a link"),
        (raw_data, f"data of '{NAME}' lie in another file"),
        (virtual, f"data of '{NAME}' lie in another file"),
        (bomb, f"'{NAME}' is said to have 24000000000 bytes"),
    ],
)
def test_files_that_reach_out_or_swell_are_refused(tmp_path, make, message):
    secret = tmp_path / "secret.h5"
    with h5py.File(secret, "w") as file:
        file["x"] = np.ones((4, 3, 2), "f4")
    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as file:
        file["faces"] = np.array([[0, 1, 2], [0, 2, 3]])
        make(file, secret)
    with pytest.raises(InputError, match=message):
        dyna_collection(path)


def test_a_store_whose_parts_lie_elsewhere_is_refused(tmp_path):
    path = tmp_path / "s.h5"
    with h5py.File(path, "w") as file:
        file.attrs["format"] = "esd-descriptors-1"
        file["mean"] = h5py.ExternalLink("elsewhere.h5", "/mean")
    with pytest.raises(InputError, match="'mean' is a link"):
        open_store(path)


def test_groups_and_packed_data_are_let_through(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_group("g")
        file.create_dataset("zeros", data=np.zeros(10**6), compression="gzip")
        check_self_contained(file)


def test_a_file_whose_index_is_damaged_is_named(tmp_path):
    path = tmp_path / "a.h5"
    with h5py.File(path, "w", libver="latest") as file:
        file["faces"] = np.array([[0, 1, 2], [0, 2, 3]])
        file[NAME] = np.ones((4, 3, 2), "f4")
    whole = path.read_bytes()
    at = whole.rindex(b"OHDR")  # a header of an object, which its checksum guards
    path.write_bytes(whole[: at + 5] + b"\xff" + whole[at + 6 :])
    with pytest.raises(InputError, match=r"a.h5' is damaged: .* Get it anew"):
        dyna_collection(path)
