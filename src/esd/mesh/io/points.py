"""Files of points without faces: XYZ, and PCD of the Point Cloud Library."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from esd.common import InputError, number_lines

_KINDS = {"F": "f", "I": "i", "U": "u"}


def read_xyz(path: Path) -> npt.NDArray[Any]:
    """A point a line, (n, 3): its first three numbers, with spaces, commas or semicolons between.

    A first line of words, the names of columns, is passed over, and one that counts the others.
    """
    lines, between = number_lines(path.read_text(encoding="utf-8-sig"))
    if lines and lines[0].strip() == str(len(lines) - 1):
        del lines[0]
    with warnings.catch_warnings():  # of a file without points, which is refused here
        warnings.simplefilter("ignore")
        points = np.loadtxt(lines, ndmin=2, usecols=(0, 1, 2), delimiter=between)
    if len(points) == 0:
        raise InputError("there are no points in it.")
    return points


def read_pcd(path: Path) -> npt.NDArray[Any]:
    """The points of a PCD file, (n, 3), text or binary.

    Raises
    ------
    InputError
        If it has no x, y and z, is compressed, or is cut short.
    """
    content = path.read_bytes()
    head: dict[str, list[str]] = {}
    at = 0
    while "DATA" not in head:
        end = content.find(b"\n", at)
        if end < 0:
            raise InputError("its head has no line DATA; is it a PCD file?")
        words = content[at:end].decode("latin-1").split()
        at = end + 1
        if words and not words[0].startswith("#"):
            head[words[0].upper()] = words[1:]
    names, count = head["FIELDS"], int(head["POINTS"][0])
    widths = [int(word) for word in head.get("COUNT", ["1"] * len(names))]
    if not {"x", "y", "z"} <= set(names):
        raise InputError(f"its points have no x, y and z, only {', '.join(names)}.")
    form = head["DATA"][0].lower()
    if form == "ascii":
        starts = dict(zip(names, (np.cumsum(widths) - widths).tolist(), strict=True))
        lines = content[at:].decode("latin-1").splitlines()
        points = np.loadtxt(lines, ndmin=2, usecols=[starts[axis] for axis in "xyz"])
    elif form == "binary":
        kinds = [f"<{_KINDS[t]}{s}" for t, s in zip(head["TYPE"], head["SIZE"], strict=True)]
        row = np.dtype(
            [
                (f"{name}" if name in "xyz" else f"{name}{number}", kind, (width,))
                for number, (name, kind, width) in enumerate(zip(names, kinds, widths, strict=True))
            ]
        )
        if count * row.itemsize > len(content) - at:
            raise InputError(f"it announces {count} points, more than it holds; is it cut short?")
        table = np.frombuffer(content, row, count=count, offset=at)
        points = np.concatenate([table[axis] for axis in "xyz"], axis=1).astype(float)
    else:
        raise InputError(f"its data are '{form}'; save it as ascii or binary.")
    if len(points) != count or count == 0:
        raise InputError(f"it announces {count} points, {len(points)} were read.")
    return points
