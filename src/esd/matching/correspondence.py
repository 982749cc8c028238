"""A map from the vertices of one shape to those of another."""

from __future__ import annotations

import csv
import io
import logging
import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from esd.common import (
    BoolArray,
    FloatArray,
    InputError,
    IntArray,
    existing_file,
    read_array,
    reason,
    table_rows,
    whole_file,
    whole_number,
)
from esd.matching.confidence import Judgement

_log = logging.getLogger(__name__)

MAP_SUFFIXES = (".csv", ".npy", ".txt", ".vts")
"""Suffixes of the files that hold a map."""


@dataclass(frozen=True, slots=True, eq=False)
class Correspondence:
    """For each vertex of a source shape, its vertex of a target shape.

    Parameters
    ----------
    target_index : (n,) int64
        `target_index[i]` is the target vertex of source vertex `i`, from 0; -1 for none.
    distance : (n,)
        Euclidean distance of the two descriptors; infinite for none.
    confidence : (n,)
        Between 0 and 1: of maps by `match` between meshes, the probability that the match is
        within 5 % of the target's geodesic diameter of the truth, and zero where that would lie in
        a hole of the target; otherwise the similarity of the
        two descriptors, exp(−distance² / C).
    judgement
        Of the map as a whole, where it was judged.
    """

    target_index: IntArray
    distance: FloatArray
    confidence: FloatArray
    judgement: Judgement | None = None

    def rejecting(self, squared_distance: float) -> Correspondence:
        """The map without the matches whose squared distance is larger."""
        return self.keeping(self.distance**2 <= squared_distance)

    def confident(self, least: float) -> Correspondence:
        """The map without the matches of less confidence; those whose confidence is NaN stay."""
        return self.keeping(~(self.confidence < least))

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the map, see `save_map`."""
        save_map(self, path)

    def __repr__(self) -> str:
        count = len(self.target_index)
        verdict = f", {self.judgement.verdict}" if self.judgement else ""
        return f"<Correspondence: {self.is_matched().sum()} of {count} vertices matched{verdict}>"

    def keeping(self, keep: BoolArray) -> Correspondence:
        """The map without the matches of the source vertices that are not to keep, (n,)."""
        return replace(
            self,
            target_index=np.where(keep, self.target_index, -1),
            distance=np.where(keep, self.distance, np.inf),
            confidence=np.where(keep, self.confidence, 0.0),
        )

    def attributes(self) -> dict[str, npt.NDArray[Any]]:
        """What is known of each source vertex, (n,) each, by its name in files of attributes."""
        return {
            "target": self.target_index,
            "distance": self.distance,
            "confidence": self.confidence,
        }

    def is_matched(self) -> BoolArray:
        """Whether each source vertex has a target vertex, (n,)."""
        return self.target_index >= 0

    def coverage(self, target_count: int) -> float:
        """Share of the target's vertices, of which there are so many, that are matched."""
        return len(np.unique(self.target_index[self.is_matched()])) / target_count

    def _repr_html_(self) -> str:
        """A table and a histogram of the confidence, for notebooks."""
        matched = self.is_matched()
        count, reached = len(matched), len(np.unique(self.target_index[matched]))
        rows = {
            "source vertices": f"{count}",
            "matched": f"{matched.sum()} ({matched.mean():.0%})" if count else "0",
            "different target vertices": f"{reached}",
        }
        known = self.confidence[matched & np.isfinite(self.confidence)]
        if len(known):
            rows["median confidence"] = f"{np.median(known):.2f}"
            rows["confidence, 0 to 1"] = _histogram(known)
        cells = "".join(f"<tr><th>{k}</th><td>{v}</td></tr>" for k, v in rows.items())
        return f"<table><caption>Correspondence</caption>{cells}</table>"


def _histogram(values: FloatArray) -> str:
    """Twenty bars over the values from 0 to 1, as SVG."""
    counts, _ = np.histogram(values, bins=20, range=(0, 1))
    bars = "".join(
        f'<rect x="{8 * i}" y="{40 - 40 * share:.1f}" width="7" height="{40 * share:.1f}"/>'
        for i, share in enumerate(counts / counts.max())
    )
    return f'<svg width="160" height="40" fill="currentColor">{bars}</svg>'


def check_map_path(path: str | os.PathLike[str]) -> Path:
    """The path, if its suffix is one of `MAP_SUFFIXES`; raises an `InputError` otherwise."""
    path = Path(path)
    if path.suffix.lower() not in MAP_SUFFIXES:
        raise InputError(f"'{path}': a map's file ends in one of {', '.join(MAP_SUFFIXES)}.")
    return path


def save_map(match: Correspondence, path: str | os.PathLike[str]) -> None:
    """Write a map; the suffix chooses the format.

    `.csv`: `source,target,distance,confidence`, vertices from 0, the target -1 where there is
    none. `.npy`: the target vertices from 0, -1 for none. `.txt` and `.vts`: the target vertex of
    each source vertex from 1, one a line, 0 for none.

    Raises
    ------
    InputError
        If the suffix is unknown or the file cannot be written.
    """
    path = check_map_path(path)
    content = io.BytesIO()
    if path.suffix.lower() == ".npy":
        np.save(content, match.target_index, allow_pickle=False)
    elif path.suffix.lower() == ".csv":
        rows = zip(match.target_index, match.distance, match.confidence, strict=True)
        lines = [f"{i},{t},{d:.9g},{c:.6g}" for i, (t, d, c) in enumerate(rows)]
        content.write("\n".join(["source,target,distance,confidence", *lines, ""]).encode())
    else:
        content.write("\n".join([*map(str, match.target_index + 1), ""]).encode())
    with whole_file(path) as temporary:
        temporary.write_bytes(content.getvalue())


def load_map(
    path: str | os.PathLike[str],
    *,
    source_count: int | None = None,
    target_count: int | None = None,
) -> Correspondence:
    """The map in a file that `save_map` wrote, or another program in the same format.

    Distances and confidences that a format does not hold are NaN. Lines of a `.csv` file may be in
    any order.

    Parameters
    ----------
    source_count, target_count
        Vertices of the two meshes, to which the map must fit; by default they are not checked.

    Raises
    ------
    InputError
        If the file is damaged or fits other meshes.
    """
    path = existing_file(check_map_path(path))
    try:
        index, distance, confidence = _parse(path)
    except InputError as error:
        if str(path) in str(error):
            raise
        raise InputError(f"'{path}' holds no map: {error}.") from error
    except (ValueError, OSError, KeyError, EOFError, OverflowError, csv.Error) as error:
        raise InputError(f"'{path}' holds no map: {reason(error)}.") from error
    if source_count is not None and len(index) != source_count:
        raise InputError(
            f"'{path}' maps {len(index)} vertices; the source mesh has {source_count}."
        )
    is_text = path.suffix.lower() in (".txt", ".vts")
    below = index[index < -1]
    if len(below):
        raise InputError(
            f"'{path}' names target vertex {below[0] + is_text}; expected {0 if is_text else -1} "
            "for a vertex without a match, or more."
        )
    if target_count is not None:
        beyond = index[index >= target_count]
        if len(beyond):
            raise InputError(
                f"'{path}' names target vertex {beyond[0]} (from 0); "
                f"the target mesh has {target_count} vertices."
            )
        if is_text and (index == -1).any() and not (index == target_count - 1).any():
            _log.warning(
                "'%s' holds zeros, which mean no match, and never the last vertex: if it counts "
                "vertices from 0 and not from 1, save it as .csv or .npy.",
                path,
            )
    return Correspondence(index, distance, confidence)


def _parse(path: Path) -> tuple[IntArray, FloatArray, FloatArray]:
    suffix = path.suffix.lower()
    if suffix == ".csv":
        return _parse_table(path)
    if suffix == ".npy":
        array = read_array(path)
        if array.ndim != 1 or array.dtype.kind not in "iu":
            raise InputError(f"expected integers of shape (n,), got {array.dtype} {array.shape}")
        index = array.astype(np.int64)
    else:
        index = _numbers(_whole_text(path)) - 1
    if len(index) == 0:
        raise InputError("it is empty")
    return index, np.full(len(index), np.nan), np.full(len(index), np.nan)


def _number(cell: str | None, *, least: float, most: float = np.inf) -> float:
    """The number in a cell of a table, within bounds; NaN where there is none."""
    value = float(cell or "nan")
    if value < least or value > most:
        raise InputError(f"expected a number from {least:g} to {most:g}; got '{cell}'")
    return value


def _numbers(text: str) -> IntArray:
    """Whole numbers with white space between."""
    try:
        return np.array(text.split(), dtype=np.int64)
    except (ValueError, OverflowError) as error:
        for number, line in enumerate(text.splitlines(), start=1):
            _check_numbers(line, number)
        raise InputError("expected whole numbers") from error


def _check_numbers(line: str, number: int) -> None:
    try:
        for word in line.split():
            whole_number(word)
    except InputError as error:
        raise InputError(f"line {number}: {error}") from error


def _whole_text(path: Path) -> str:
    """The text of a file, if its last line is whole."""
    text = path.read_text(encoding="utf-8-sig")
    if not text.strip():
        raise InputError("it is empty")
    if not text.endswith(("\n", "\r")):
        raise InputError("its last line has no line break: add one, if it is not cut short")
    return text


def _parse_table(path: Path) -> tuple[IntArray, FloatArray, FloatArray]:
    """The columns of a `.csv` file in the order of the source vertices."""
    text = _whole_text(path)
    columns, rows = table_rows(text)
    if not {"source", "target"} <= columns:
        raise InputError("expected the columns source,target,distance,confidence")
    source, target, distance, confidence = [], [], [], []
    try:
        line = 1
        for line, row in rows:  # noqa: B007 (for the error)
            source.append(whole_number(row["source"]))
            target.append(whole_number(row["target"]))
            distance.append(_number(row.get("distance"), least=0.0))
            confidence.append(_number(row.get("confidence"), least=0.0, most=1.0))
    except (InputError, TypeError, ValueError) as error:
        raise InputError(f"line {line}: {error}") from error
    if not source:
        raise InputError("no line follows the names of its columns")
    order = np.argsort(np.array(source, dtype=np.int64), kind="stable")
    found = np.array(source, dtype=np.int64)[order]
    wrong = np.flatnonzero(found != np.arange(len(found)))
    if len(wrong):
        at = int(wrong[0])  # those before are 0, 1, 2, …: this one is repeated, or skips some
        fault = f"{found[at]} has two lines" if found[at] < at else f"{at} has no line"
        if found[at] < 0:
            fault = f"{found[at]} is none"
        raise InputError(f"source vertex {fault}; expected one line for each, from 0 on")
    # row order[i] is that of source vertex i
    return (
        np.array(target, dtype=np.int64)[order],
        np.array(distance)[order],
        np.array(confidence)[order],
    )
