"""Files of descriptors."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from esd.common import FloatArray, InputError, whole_file
from esd.mesh.io.fields import write_values

_SUFFIXES = (".npy", ".npz", ".h5", ".csv")


def check_descriptor_path(path: str | os.PathLike[str]) -> Path:
    """The path, if descriptors can be written to it; raises an `InputError` otherwise."""
    path = Path(path)
    if path.suffix.lower() not in _SUFFIXES:
        raise InputError(f"'{path}': descriptors are written to {', '.join(_SUFFIXES)}.")
    return path


def save_descriptor(values: FloatArray, path: str | os.PathLike[str]) -> None:
    """Write descriptors (n, d): an array, an array named `descriptors` (`.npz`, `.h5`), or lines.

    Raises
    ------
    InputError
        If the suffix is unknown or the file cannot be written.
    """
    path = check_descriptor_path(path)
    if path.suffix.lower() == ".h5":
        import h5py

        with whole_file(path) as temporary, h5py.File(temporary, "w") as store:
            store["descriptors"] = values
    elif path.suffix.lower() == ".npz":
        with whole_file(path) as temporary, temporary.open("wb") as file:
            np.savez(file, descriptors=values)
    else:
        write_values(values, path)
