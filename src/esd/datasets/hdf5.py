"""HDF5 files that hold all of their data themselves."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import h5py

from esd.common import InputError, reason

_LARGEST = 2**30  # bytes of a data set; a larger one must be as large in the file


@contextmanager
def about_damage(path: Path) -> Iterator[None]:
    """Name the file where HDF5 stumbles over what it holds.

    Raises
    ------
    InputError
        In place of the errors that h5py raises, of many kinds, on damaged files.
    """
    try:
        yield
    except InputError:
        raise
    except (
        OSError,
        KeyError,
        IndexError,
        TypeError,
        ValueError,
        RuntimeError,
        ArithmeticError,
    ) as error:
        raise InputError(f"'{path}' is damaged: {reason(error)}. Get it anew.") from error


def check_self_contained(file: h5py.File) -> None:
    """Refuse a file whose members lie elsewhere, or unpack to far more than the file holds.

    HDF5 would follow links into any file that the user may read, take raw data from it, and fill
    with zeros what was never written.

    Parameters
    ----------
    file
        All of its data sets are members of its root.

    Raises
    ------
    InputError
        If a member is a link, a data set has its data elsewhere, or has more than a GiB and more
        than the file.
    """
    size = file.id.get_filesize()
    for name in file:
        if not isinstance(file.get(name, getlink=True), h5py.HardLink):
            raise InputError(f"'{file.filename}': '{name}' is a link; copy its data into the file.")
        member = file[name]
        if not isinstance(member, h5py.Dataset):
            continue
        if member.is_virtual or member.external:
            raise InputError(
                f"'{file.filename}': the data of '{name}' lie in another file; copy them in."
            )
        if member.nbytes > max(size, _LARGEST):
            raise InputError(
                f"'{file.filename}': '{name}' is said to have {member.nbytes} bytes; "
                f"the file has {size}."
            )
