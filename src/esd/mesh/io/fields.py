"""Files of what is known at the vertices or faces of a mesh: labels and values."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from esd.common import (
    FloatArray,
    InputError,
    IntArray,
    existing_file,
    number_lines,
    read_array,
    reason,
    whole_file,
)

FIELD_SUFFIXES = (".npy", ".csv", ".txt")


def check_field_path(path: str | os.PathLike[str]) -> Path:
    """The path, if labels or values can be in it; raises an `InputError` otherwise."""
    path = Path(path)
    if path.suffix.lower() not in FIELD_SUFFIXES:
        raise InputError(f"'{path}': expected a name that ends in {', '.join(FIELD_SUFFIXES)}.")
    return path


def read_labels(path: str | os.PathLike[str]) -> tuple[IntArray, tuple[str, ...] | None]:
    """Labels in a file, and their names where the file holds words; labels then count these.

    A `.npy` file holds integers (n,), a `.txt` or `.csv` file one integer or word a line.

    Raises
    ------
    InputError
        If there is no such file or it holds something else.
    """
    path = _existing(path)
    if path.suffix.lower() == ".npy":
        array = read_array(path)
        if array.ndim != 1 or array.dtype.kind not in "iu":
            raise InputError(
                f"'{path}' must hold integers of shape (n,); got {array.dtype} {array.shape}."
            )
        return array.astype(np.int64), None
    words = [line.strip() for line in _text(path).splitlines() if line.strip()]
    if not words:
        raise InputError(f"'{path}' is empty.")
    try:
        return np.array(words, dtype=np.int64), None
    except (ValueError, OverflowError):
        names, labels = np.unique(words, return_inverse=True)
        return labels, tuple(names.tolist())


def write_labels(
    labels: IntArray, path: str | os.PathLike[str], names: tuple[str, ...] | None = None
) -> None:
    """Write labels as `read_labels` reads them; the name of -1 is `none`.

    Raises
    ------
    InputError
        If the suffix is unknown or the file cannot be written.
    """
    path = check_field_path(path)
    if path.suffix.lower() == ".npy":
        _save(labels, path)
        return
    words = map(str, labels) if names is None else np.array(("none", *names))[labels + 1]
    with whole_file(path) as temporary:
        temporary.write_text("".join(f"{word}\n" for word in words), encoding="utf-8")


def read_values(path: str | os.PathLike[str]) -> FloatArray:
    """Numbers in a file, (n,) or (n, d): an array, or a line for each vertex.

    Numbers in a line are separated by spaces, commas or semicolons; beside semicolons a comma is
    that of a decimal. Cells that are empty, or `NA`, are NaN. A first line of words names the
    columns.

    Raises
    ------
    InputError
        If there is no such file or it holds something else.
    """
    path = _existing(path)
    if path.suffix.lower() == ".npy":
        array = read_array(path)
        if array.ndim not in (1, 2) or array.dtype.kind not in "iuf":
            raise InputError(
                f"'{path}' must hold numbers, (n,) or (n, d); got {array.dtype} {array.shape}."
            )
        return array.astype(float)
    lines, between = number_lines(_text(path))
    if not lines:
        raise InputError(f"'{path}' is empty.")
    try:
        values = np.loadtxt(
            lines, ndmin=2, delimiter=between, converters=_number if between else None
        )
    except ValueError as error:
        raise InputError(f"'{path}' must hold numbers for each vertex: {reason(error)}.") from error
    return values[:, 0] if values.shape[1] == 1 else values


def _number(cell: str) -> float:
    """The number in a cell of a line, NaN where there is none."""
    return float(cell) if cell.strip() not in ("", "NA") else np.nan


def write_values(values: FloatArray, path: str | os.PathLike[str]) -> None:
    """Write values as `read_values` reads them.

    Raises
    ------
    InputError
        If the suffix is unknown or the file cannot be written.
    """
    path = check_field_path(path)
    if path.suffix.lower() == ".npy":
        _save(values, path)
        return
    with whole_file(path) as temporary:
        np.savetxt(temporary, values, delimiter=",", fmt="%.9g")


def _existing(path: str | os.PathLike[str]) -> Path:
    return existing_file(check_field_path(path))


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"'{path}' cannot be read: {reason(error)}.") from error


def _save(values: npt.NDArray[Any], path: Path) -> None:
    with whole_file(path) as temporary, temporary.open("wb") as file:
        np.save(file, values, allow_pickle=False)
