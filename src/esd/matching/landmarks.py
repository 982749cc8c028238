"""Maps from a few landmarks: points that are known to correspond, clicked some edges off."""

from __future__ import annotations

import csv
import os
from collections.abc import Mapping, Sequence

import numpy as np

from esd.common import (
    FloatArray,
    InputError,
    IntArray,
    existing_file,
    reason,
    table_rows,
    whole_number,
)
from esd.matching.anchors import nearness
from esd.matching.candidates import (
    Candidate,
    Rows,
    Sampled,
    extrinsic_candidate,
    rows_one_way,
    spectral_candidate,
)
from esd.matching.extrinsic import aligned, deformed
from esd.mesh.geodesics import geodesic_graph
from esd.mesh.geometry import surface_area, unit
from esd.mesh.io.landmarks import Landmarks
from esd.mesh.mesh import Mesh
from esd.nearest import nearest
from esd.parallel import side_by_side

FEWEST = 3
"""Number of landmarks that are needed."""

_BY_LANDMARKS = "landmarks+"  # begins the names of `LANDMARK_CANDIDATES`
_EXTRINSIC = f"{_BY_LANDMARKS}extrinsic"

_WEIGHT = 3.0  # of rows of landmarks
_EMBEDDING_WEIGHT = 0.3  # of embeddings beside them, which have unit length
_DESCRIPTOR_WEIGHT = 0.3  # of descriptors beside them, whose length is about three
_FOLDS = 12  # maps that are computed to find landmarks that the others contradict
_FEWEST_TO_DOUBT = 5  # landmarks, of fewer than which none can be contradicted
_ASTRAY, _TIMES = 0.2, 4.0  # in √area, and in medians, beyond which a landmark is contradicted


def check_landmarks(landmarks: IntArray, source_count: int, target_count: int) -> IntArray:
    """Pairs of vertices, (l, 2) int64, three or more.

    Raises
    ------
    InputError
        If they are not so.
    """
    landmarks = np.asarray(landmarks)
    if landmarks.ndim != 2 or landmarks.shape[1] != 2 or landmarks.dtype.kind not in "iu":
        raise InputError(
            "Landmarks must be pairs of vertices, integers of shape (l, 2); "
            f"got {landmarks.dtype} {landmarks.shape}."
        )
    for name, column, count in zip(
        ("source", "target"), landmarks.T, (source_count, target_count), strict=True
    ):
        if len(column) and not 0 <= column.min() <= column.max() < count:
            raise InputError(
                f"Landmarks of the {name} must be vertices from 0 to {count - 1}; "
                f"got {column.min()} to {column.max()}."
            )
    different = min(len(np.unique(column)) for column in landmarks.T)
    if different < FEWEST:
        raise InputError(f"{FEWEST} different landmarks or more are needed; got {different}.")
    return landmarks.astype(np.int64)


def read_landmark_pairs(path: str | os.PathLike[str]) -> tuple[tuple[str, ...], IntArray]:
    """Names and pairs of vertices, (l, 2) from 0, in a CSV file with columns `source,target`.

    A column `name` names them; by default they are numbered from 1.

    Raises
    ------
    InputError
        If the file is missing or not so.
    """
    path = existing_file(path)
    names: list[str] = []
    pairs: list[tuple[int, int]] = []
    try:
        columns, rows = table_rows(path.read_text(encoding="utf-8-sig"))
        if not {"source", "target"} <= columns:
            raise InputError(f"'{path}' must have the columns source,target; or give two files.")
        for line, row in rows:
            where = f"'{path}', line {line}"
            pairs.append((_vertex(row, "source", where), _vertex(row, "target", where)))
            names.append(row.get("name") or str(len(pairs)))
    except (csv.Error, UnicodeDecodeError) as error:
        raise InputError(f"'{path}' is no CSV file: {reason(error)}.") from error
    if not pairs:
        raise InputError(f"'{path}' lists no landmarks.")
    return tuple(names), np.array(pairs, dtype=np.int64)


def _vertex(row: Mapping[str, str], column: str, where: str) -> int:
    """The vertex in a column of a row of a table."""
    try:
        vertex = whole_number(row[column])
    except InputError as error:
        raise InputError(f"{where}, {column}: {error}.") from error
    if vertex < 0:
        raise InputError(f"{where}, {column}: vertices are counted from 0; got {vertex}.")
    return vertex


def paired_landmarks(source: Landmarks, target: Landmarks) -> tuple[tuple[str, ...], IntArray]:
    """Names that both shapes have, in the order of the source, and their vertices, (l, 2).

    Raises
    ------
    InputError
        If fewer than three names are in both, or one of them is there twice.
    """
    there = dict(zip(target.names, target.vertices.tolist(), strict=True))
    found = {
        name: (vertex, there[name])
        for name, vertex in zip(source.names, source.vertices.tolist(), strict=True)
        if vertex >= 0 and there.get(name, -1) >= 0
    }
    for names in (source.names, target.names):
        twice = [name for name in found if names.count(name) > 1]
        if twice:
            raise InputError(f"Several landmarks have the name '{twice[0]}'; give them others.")
    if len(found) < FEWEST:
        raise InputError(
            f"{FEWEST} landmarks or more must have a name that both files have; "
            f"got {len(found)}: {', '.join(found) or 'none'}."
        )
    return tuple(found), np.array(list(found.values()))


def landmark_rows(mesh: Mesh, vertices: IntArray) -> FloatArray:
    """Rows (n, l) of unit length that say how near each vertex is to each landmark.

    See `esd.matching.anchors.nearness`.

    Parameters
    ----------
    vertices : (l,)
        The landmarks.
    """
    return nearness(geodesic_graph(mesh).distances(vertices) / np.sqrt(surface_area(mesh)))


def landmark_candidates(
    source: Sampled,
    target: Sampled,
    landmarks: IntArray,
    rows: dict[str, Rows],
    names: Sequence[str],
) -> list[Candidate]:
    """The candidates that landmarks give, of those named.

    Parameters
    ----------
    landmarks : (l, 2)
        Vertices of the shapes.
    rows
        Embeddings and descriptors of all vertices, by name.
    """
    beside = _beside(source, target, landmarks, rows)

    def candidate(name: str) -> Candidate:
        if name != _EXTRINSIC:
            embeddings = beside[name.removeprefix(_BY_LANDMARKS)]
            return spectral_candidate(name, source, target, embeddings)
        pairs = landmarks[:, 0], landmarks[:, 1]
        alignment = aligned(source.posed, target.posed, matches=[pairs], search=False)
        moved = deformed(alignment.source, target.posed, landmarks=pairs)
        return extrinsic_candidate(moved, target.posed, name=name)

    known = [_EXTRINSIC, *(f"{_BY_LANDMARKS}{name}" for name in beside)]  # the slowest first
    return side_by_side(candidate, [name for name in known if name in names])


def contradicted(
    source: Sampled, target: Sampled, landmarks: IntArray, descriptors: Rows
) -> IntArray:
    """Which landmarks, as indices, the others contradict, the farthest astray first.

    Each is left out of a map in turn (many in groups), and is compared with where that map sends
    it. The one that is farthest astray is dropped before the others are asked again, since a wrong
    landmark misleads the maps that judge the right ones. Of fewer than five landmarks none can be
    contradicted.
    """
    left = np.arange(len(landmarks))
    dropped: list[int] = []
    if len(left) < _FEWEST_TO_DOUBT:
        return np.array(dropped, dtype=np.int64)
    near = (
        landmark_rows(_mesh(source), landmarks[:, 0]),
        landmark_rows(_mesh(target), landmarks[:, 1]),
    )
    away = geodesic_graph(_mesh(target)).distances(landmarks[:, 1])
    away /= np.sqrt(surface_area(_mesh(target)))
    while len(left) >= _FEWEST_TO_DOUBT:
        rows = near[0][:, left], near[1][:, left]
        miss = _misses(source, target, landmarks[left], rows, away[left], descriptors)
        worst = int(miss.argmax())
        if miss[worst] <= max(_ASTRAY, _TIMES * float(np.median(miss))):
            break
        dropped.append(int(left[worst]))
        left = np.delete(left, worst)
    return np.array(dropped, dtype=np.int64)


def _misses(
    source: Sampled,
    target: Sampled,
    landmarks: IntArray,
    near: Rows,
    away: FloatArray,
    descriptors: Rows,
) -> FloatArray:
    """Distances, (l,), from each landmark to where a map by the others sends it.

    Parameters
    ----------
    near
        Of `landmark_rows`, a column for each landmark.
    away : (l, m)
        Distances from each landmark of the target to all vertices.
    """
    fold = np.arange(len(landmarks)) % min(len(landmarks), _FOLDS)
    miss = np.empty(len(landmarks))

    def without(left_out: int) -> tuple[IntArray, FloatArray]:
        used = fold != left_out
        embeddings = _joined(
            (unit(near[0][:, used]), unit(near[1][:, used])), descriptors, _DESCRIPTOR_WEIGHT
        )
        found = rows_one_way(source, target, embeddings)
        out = np.flatnonzero(~used)
        image = nearest(found[0][landmarks[out, 0]], found[1])[0]
        return out, away[out, image]

    for out, distance in side_by_side(without, np.unique(fold).tolist()):
        miss[out] = distance
    return miss


def _beside(
    source: Sampled, target: Sampled, landmarks: IntArray, rows: dict[str, Rows]
) -> dict[str, Rows]:
    """Rows of landmarks with others beside them, of both shapes, by the name of the others."""
    near = (
        landmark_rows(_mesh(source), landmarks[:, 0]),
        landmark_rows(_mesh(target), landmarks[:, 1]),
    )
    weights = {"embedding": _EMBEDDING_WEIGHT, "descriptors": _DESCRIPTOR_WEIGHT}
    return {name: _joined(near, each, weights[name]) for name, each in rows.items()}


def _joined(near: Rows, rows: Rows, weight: float) -> Rows:
    return (
        np.hstack([_WEIGHT * near[0], weight * rows[0]]),
        np.hstack([_WEIGHT * near[1], weight * rows[1]]),
    )


def _mesh(shape: Sampled) -> Mesh:
    assert isinstance(shape.features.shape, Mesh)
    return shape.features.shape
