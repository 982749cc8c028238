"""What every stage uses: array types, the error for bad input, and writing files whole."""

from __future__ import annotations

import contextlib
import csv
import ctypes
import io
import os
import re
import shutil
import sys
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

UNFINISHED = ".esd-"
"""What begins names of files and folders that are being written, or were left by a kill."""

_EXCHANGE = 2  # RENAME_EXCHANGE of renameat2(2)
_HERE = -100  # AT_FDCWD
_OBJECTS = "it holds Python objects, which are not loaded, since they can run code"
_PLAIN = {  # what int, float, numpy, struct and json say
    r"invalid literal for int\(\) with base 10: b?'(.*)'": r"expected a whole number; got '\1'",
    r"could not convert string to float: b?'(.*)'": r"expected a number; got '\1'",
    r"; use `usecols`.*": "",
    r"invalid column index \d+ at row (\d+) with (\d+) columns?": r"line \1 has only \2 columns",
    r"could not convert string '(.*)' to \w+ at": r"expected a number; got '\1' at",
    r"Exceeds the limit .* for integer string conversion.*": "a whole number is too long",
    r"Python int too large to convert to C \w+": "a whole number is beyond 64 bits",
    r"maximum recursion depth exceeded.*": "it is nested too deeply",
    r"unpack(_from)? requires a buffer of.*": "it is cut short",
    r"This file contains pickled \(object\) data.*": "it is no .npy file",  # so of anything else
    r"Object arrays cannot be loaded.*": _OBJECTS,
    r"Array can't be memory-mapped: Python objects in dtype": _OBJECTS,
}
_LONGEST = 18  # digits of a number that 64 bits hold


class InputError(ValueError):
    """Input that cannot be used; the message says what was expected, what came, what to do."""


def install_hint(extra: str) -> str:
    """Command that installs the optional dependencies `extra` (`train`, `viz`, …)."""
    return f"pip install '{DISTRIBUTION}[{extra}]'"


def is_count(value: object) -> bool:
    """Whether a value that was read from a file is a whole number, one or more."""
    return isinstance(value, int) and not isinstance(value, bool) and value >= 1


def is_positive(value: object) -> bool:
    """Whether a value that was read from a file is a positive, finite number."""
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    return is_number and 0 < value < float("inf")  # type: ignore[operator]


def is_file(path: str | os.PathLike[str]) -> bool:
    """Whether there is a file; names that no file can have, too long or with a zero, are none."""
    return os.path.isfile(path)  # noqa: PTH113 (pathlib raises on such names)


def existing_file(path: str | os.PathLike[str]) -> Path:
    """The path, if there is a file.

    Raises
    ------
    InputError
        If there is none.
    """
    if not is_file(path):
        raise InputError(f"There is no file '{os.fspath(path)}'.")
    return Path(path)


def read_array(path: str | os.PathLike[str]) -> npt.NDArray[Any]:
    """The array in a `.npy` file, mapped: a header that announces too much costs nothing.

    Raises
    ------
    InputError
        If there is no such file, or no array in it.
    """
    path = existing_file(path)
    try:
        array = np.load(path, mmap_mode="r", allow_pickle=False)
    except Exception as error:  # numpy parses the header as Python, which fails in many ways
        raise InputError(f"'{path}' holds no array: {reason(error)}.") from error
    if not isinstance(array, np.ndarray):
        array.close()
        raise InputError(f"'{path}' holds no array: it is an archive, as in .npz files.")
    return array


def reason(error: Exception) -> str:
    """Why something could not be parsed, in one line and in plain words where Python's are not."""
    if isinstance(error, UnicodeDecodeError):
        return f"byte {error.start + 1} of it is no text in UTF-8"
    said = " ".join(str(error).split()).rstrip(".")
    for pattern, words in _PLAIN.items():
        said = re.sub(pattern, words, said)
    return said


def whole_number(cell: str | None) -> int:
    """The whole number in a cell of a table or in a word of a text.

    Raises
    ------
    InputError
        If there is none, or it is beyond 64 bits. The message says neither file nor line.
    """
    text = (cell or "").strip()
    digits = text.removeprefix("-")
    if not (digits.isascii() and digits.isdigit() and len(digits) <= _LONGEST):
        shown = f"got '{text[:40]}'" if text else "the cell is empty"
        raise InputError(f"expected a whole number; {shown}")
    return int(text)


def number_lines(text: str) -> tuple[list[str], str | None]:
    """Lines of numbers in a text, and the sign between numbers, None for spaces.

    A first line of words, the names of columns, is left out; comments (`#`) stay. Where semicolons
    are between numbers, commas may be within, as spreadsheets write them: they become points.
    """
    lines = [line for line in text.splitlines() if line.strip()]
    first = next((i for i, line in enumerate(lines) if not line.lstrip().startswith("#")), None)
    head = "" if first is None else lines[first]
    between = next((sign for sign in ";," if sign in head), None)
    words = head.replace(between or " ", " ").split()
    if first is not None and first + 1 < len(lines) and not any(map(_is_number, words)):
        del lines[first]
    if between == ";":
        lines = [line.replace(",", ".") for line in lines]
    return lines, between


def _is_number(word: str) -> bool:
    try:
        float(word.replace(",", "."))
    except ValueError:
        return False
    return True


def table_rows(text: str) -> tuple[frozenset[str], Iterator[tuple[int, dict[str, str]]]]:
    """Names of the columns of a table, and its rows: the line, and the cells by these names.

    Columns are separated by commas, semicolons or tabs, whichever the first line has most of, as
    spreadsheets write them. Names are in lower case; they and the cells have no space around them.
    Cells that a row lacks are empty.

    Raises
    ------
    csv.Error
        If a row cannot be parsed, when it is reached.
    """
    between = max(",;\t", key=text.partition("\n")[0].count)
    rows = csv.reader(io.StringIO(text), delimiter=between, skipinitialspace=True)
    names = [name.strip().lower() for name in next(rows, [])]

    def named() -> Iterator[tuple[int, dict[str, str]]]:
        for row in rows:
            if row:
                cells = dict(zip(names, map(str.strip, row), strict=False))
                yield rows.line_num, {**dict.fromkeys(names[len(row) :], ""), **cells}

    return frozenset(names), named()


@contextlib.contextmanager
def whole_file(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Path of a temporary file that takes the place of `path` when the block ends well.

    The temporary file lies in the folder of `path`, which is made where it does not exist, and
    has its suffix. When the block raises, or the process is interrupted, it is removed and the
    file at `path` is left as it was. A link is followed: the file it names is replaced. The new
    file has the permissions of the old one.

    Raises
    ------
    InputError
        If `path` is a folder, or its folder cannot be made or written to.
    """
    path = Path(path)
    if path.is_dir():
        raise InputError(f"'{path}' is a folder; give the name of a file to write.")
    try:
        # of the file that a link names, so that the link is kept
        place = Path(os.path.realpath(path))
        place.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(dir=place.parent, prefix=UNFINISHED, suffix=path.suffix)
    except OSError as error:
        raise InputError(f"'{path}' cannot be written: {error.strerror}.") from error
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        # mkstemp makes files that only their owner can read
        temporary.chmod(place.stat().st_mode & 0o7777 if place.exists() else 0o666 & ~_umask())
        temporary.replace(place)
    except OSError as error:
        if error.filename is None:  # of writing to what is open: the disk is full
            raise InputError(f"'{path}' cannot be written: {error.strerror or error}.") from error
        raise
    finally:
        temporary.unlink(missing_ok=True)


@contextlib.contextmanager
def whole_folder(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Path of a temporary folder that takes the place of `path` when the block ends well.

    As `whole_file`; whatever the folder at `path` held is removed once the new one is there.

    Raises
    ------
    InputError
        If `path` is a file, or its folder cannot be made or written to.
    """
    path = Path(path)
    place = Path(os.path.realpath(path))
    if place.is_file():
        raise InputError(f"'{path}' is a file; give the name of a folder to write.")
    try:
        place.parent.mkdir(parents=True, exist_ok=True)
        temporary = Path(tempfile.mkdtemp(dir=place.parent, prefix=UNFINISHED))
    except OSError as error:
        raise InputError(f"'{path}' cannot be written: {error.strerror}.") from error
    try:
        yield temporary
        temporary.chmod(place.stat().st_mode & 0o7777 if place.exists() else 0o777 & ~_umask())
        if not place.exists():
            temporary.replace(place)
        elif not _exchanged(temporary, place):
            # this system cannot exchange folders: for a moment there is none at `path`
            with tempfile.TemporaryDirectory(dir=place.parent, prefix=UNFINISHED) as aside:
                place.replace(Path(aside) / place.name)
                temporary.replace(place)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def check_can_be_made(path: str | os.PathLike[str]) -> Path:
    """The path, if its folder can be written to, or made.

    Raises
    ------
    InputError
        If part of the path is a file, or nothing can be written to the first folder that exists.
    """
    path = Path(path)
    folder = Path(os.path.realpath(path)).parent
    while not folder.exists() and folder != folder.parent:
        folder = folder.parent
    if not folder.is_dir():
        raise InputError(f"'{path}' cannot be written: '{folder}' is a file, not a folder.")
    try:
        # tried, because permissions do not say it all: file systems may be read-only or special
        with tempfile.TemporaryFile(dir=folder):
            return path
    except OSError as error:
        raise InputError(
            f"'{path}' cannot be written: in '{folder}', {error.strerror or error}."
        ) from error


def _exchanged(first: Path, second: Path) -> bool:
    """Whether two folders have exchanged their names, in one step; Linux can."""
    if not sys.platform.startswith("linux"):
        return False
    exchange = getattr(ctypes.CDLL(None), "renameat2", None)
    if exchange is None:
        return False
    names = os.fsencode(first), os.fsencode(second)
    return bool(exchange(_HERE, names[0], _HERE, names[1], _EXCHANGE) == 0)


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
