"""What every stage uses: array types, the error for bad input, and writing files whole."""

from __future__ import annotations

import contextlib
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

FloatArray: TypeAlias = npt.NDArray[np.floating[Any]]
IntArray: TypeAlias = npt.NDArray[np.int64]
BoolArray: TypeAlias = npt.NDArray[np.bool_]

DISTRIBUTION = "embedded-spectral-descriptors"
"""What pip installs; `esd` on PyPI is another package."""


class InputError(ValueError):
    """Input that cannot be used; the message says what was expected, what came, what to do."""


def install_hint(extra: str) -> str:
    """Command that installs the optional dependencies `extra` (`train`, `viz`, …)."""
    return f"pip install '{DISTRIBUTION}[{extra}]'"


@contextlib.contextmanager
def whole_file(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Path of a temporary file that takes the place of `path` when the block ends well.

    The temporary file lies in the folder of `path` and keeps its suffix. When the block raises,
    or the process is interrupted, it is removed and whatever stood at `path` stays as it was.

    Raises
    ------
    InputError
        If the folder of `path` does not exist or cannot be written to.
    """
    path = Path(path)
    if path.is_dir():
        raise InputError(f"'{path}' is a folder; give the name of a file to write.")
    if not path.parent.is_dir():
        raise InputError(f"The folder '{path.parent}' does not exist; create it first.")
    try:
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=".esd-", suffix=path.suffix)
    except OSError as error:
        raise InputError(f"'{path}' cannot be written: {error.strerror}.") from error
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        umask = os.umask(0)
        os.umask(umask)
        temporary.chmod(0o666 & ~umask)  # mkstemp makes files only their owner can read
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)
