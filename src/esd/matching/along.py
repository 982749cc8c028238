"""Data transferred along a map between shapes as people have them: defective ones, points too."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree

from esd.common import FloatArray, InputError, IntArray
from esd.matching.correspondence import Correspondence
from esd.matching.transfer import (
    Method,
    carried_labels,
    carried_landmarks,
    carried_texture,
    carried_values,
    places_of_points,
    vertex_places,
)
from esd.mesh.convert import MeshLike, as_arrays
from esd.mesh.mesh import Mesh
from esd.mesh.repair.repair import Repaired, repair

Kind: TypeAlias = Literal["auto", "values", "labels", "landmarks"]


@dataclass(frozen=True, slots=True, eq=False)
class _Pair:
    """Two repaired shapes, the map between their vertices, and the faces before the repair."""

    source: Repaired
    target: Repaired
    match: Correspondence
    source_faces: IntArray
    target_faces: IntArray


def transfer(
    data: npt.ArrayLike,
    source: MeshLike,
    target: MeshLike,
    match: Correspondence,
    *,
    kind: Kind = "auto",
    method: Method = "barycentric",
) -> npt.NDArray[Any]:
    """Data of the source's vertices or faces, transferred to those of the target along a map.

    Both shapes may be defective or point clouds: they are repaired first. The data are those of
    the vertices and faces before the repair.

    Parameters
    ----------
    data
        Values (n, ...), labels (n,) of vertices or (m,) of faces, or landmarks (l,): vertices.
    match
        From the source to the target.
    kind
        What the data are; by default values where they are floating-point, labels where they are
        integers.
    method
        Whether to interpolate in the faces, or to take the nearest matched vertex; where one of
        the shapes is a point cloud always the latter.

    Returns
    -------
    array
        Values at the target's vertices, NaN for none; labels of its vertices, or of its faces
        where the source's faces have labels, -1 for none; or the target vertices of the
        landmarks, -1 for none.

    Raises
    ------
    InputError
        If the data or the map do not fit the shapes, or nothing is matched.
    """
    data = np.asarray(data)
    if kind == "auto":
        kind = "labels" if data.dtype.kind in "iub" else "values"
    if kind == "landmarks":
        # -1 is a landmark that the source lacks
        return np.where(data == -1, -1, carried_landmarks(np.where(data == -1, 0, data), match))
    pair = _repaired_pair(source, target, match)
    vertex_count, face_count = len(pair.source.vertex_index), len(pair.source_faces)
    if kind == "labels" and len(data) == face_count != vertex_count:
        return _face_labels(data, pair, method)
    if len(data) != vertex_count:
        raise InputError(
            f"Expected one of the {kind} for each vertex of the source, {vertex_count} in all; "
            f"got {len(data)}."
        )
    index = pair.target.vertex_index
    if not (isinstance(pair.source.shape, Mesh) and isinstance(pair.target.shape, Mesh)):
        found = data[_nearest_matched(pair)]
    else:
        # places lie on the repaired source, whose vertices are copies of original ones
        here = data[pair.source.original_index]
        places = vertex_places(pair.source.shape, pair.target.shape, pair.match, method=method)
        carry: Any = carried_labels if kind == "labels" else carried_values
        found = carry(here, pair.source.shape, places)
    missing = -1 if kind == "labels" else np.nan
    found = found if kind == "labels" else found.astype(float)
    result = found[index]  # at the vertices before the repair
    result[index < 0] = missing
    return np.asarray(result)


def transferred_texture(
    coordinates: FloatArray, source: MeshLike, target: Mesh, match: Correspondence
) -> FloatArray:
    """Texture coordinates at the corners of the target's faces, (m, 3, 2), see `carried_texture`.

    Parameters
    ----------
    coordinates : (k, 3, 2)
        At the corners of the source's faces.

    Raises
    ------
    InputError
        If the coordinates or the map do not fit the meshes, one is a point cloud, or part of the
        target is out of reach.
    """
    pair = _repaired_pair(source, target, match)
    shapes = pair.source.shape, pair.target.shape
    if not (isinstance(shapes[0], Mesh) and isinstance(shapes[1], Mesh)):
        raise InputError("Textures lie on faces; one of the shapes has none.")
    if coordinates.shape != (len(pair.source_faces), 3, 2):
        raise InputError(
            f"Expected texture coordinates of shape ({len(pair.source_faces)}, 3, 2), at the "
            f"corners of the source's faces; got {coordinates.shape}."
        )
    there, here = _same_corners(_original(pair.source, pair.source_faces), _repaired(pair.source))
    carried = carried_texture(coordinates[there[:, None], here], shapes[0], shapes[1], pair.match)
    there, here = _same_corners(_repaired(pair.target), _original(pair.target, pair.target_faces))
    result = carried[there[:, None], here]
    result[there < 0] = 0.0  # faces without area
    return np.asarray(result)


def _repaired_pair(source: MeshLike, target: MeshLike, match: Correspondence) -> _Pair:
    arrays = as_arrays(source), as_arrays(target)
    counts = len(arrays[0][0]), len(arrays[1][0])
    if len(match.target_index) != counts[0]:
        raise InputError(
            f"The map has {len(match.target_index)} vertices; the source has {counts[0]}."
        )
    if match.target_index.max() >= counts[1]:
        raise InputError(
            f"The map names target vertex {match.target_index.max()} (from 0); the target has "
            f"{counts[1]}."
        )
    here, there = (repair(each, all_pieces=True) for each in arrays)
    # of original vertices that were joined, any that is matched represents the joined one
    joined = np.flatnonzero((match.target_index >= 0) & (here.vertex_index >= 0))
    reporter = here.original_index.copy()
    other = np.full(len(reporter), -1, dtype=np.int64)
    other[here.vertex_index[joined]] = joined
    silent = match.target_index[reporter] < 0
    reporter = np.where(silent & (other >= 0), other, reporter)
    index = match.target_index[reporter]
    index = np.where(index >= 0, there.vertex_index[index], -1)
    if not (index >= 0).any():
        raise InputError("The map has no match between usable parts of the shapes.")
    return _Pair(
        here,
        there,
        Correspondence(index, match.distance[reporter], match.confidence[reporter]),
        *(np.asarray(faces, dtype=np.int64).reshape(-1, 3) for _, faces in arrays),
    )


def _nearest_matched(pair: _Pair) -> IntArray:
    """The original source vertex matched nearest to each vertex of the repaired target, (r,)."""
    matched = np.flatnonzero(pair.match.is_matched())
    points = pair.target.shape.vertices
    nearest = KDTree(points[pair.match.target_index[matched]]).query(points)[1]
    return pair.source.original_index[matched[nearest]]


def _face_labels(labels: npt.NDArray[Any], pair: _Pair, method: Method) -> npt.NDArray[Any]:
    """Labels of the target's faces, -1 for none, from those of the source's, before the repair."""
    shapes = pair.source.shape, pair.target.shape
    if not (isinstance(shapes[0], Mesh) and isinstance(shapes[1], Mesh)):
        raise InputError("Labels of faces need faces on both shapes; one is a point cloud.")
    corners = pair.target.vertex_index[pair.target_faces]
    best = corners.max(axis=1)
    corners = np.where(corners >= 0, corners, best[:, None])  # -1 only where no corner is usable
    middle = shapes[1].vertices[corners].mean(axis=1)
    places = places_of_points(
        shapes[0], shapes[1], pair.match, middle, np.maximum(corners, 0), method
    )
    rows, _ = _same_corners(_original(pair.source, pair.source_faces), _repaired(pair.source))
    found = (places.face >= 0) & (best >= 0)
    return np.where(found, labels[rows[places.face]], -1)


def _original(repaired: Repaired, faces: IntArray) -> IntArray:
    """Faces before the repair, by vertices that are the same for all that were joined, (m, 3)."""
    return repaired.vertex_index[faces]


def _repaired(repaired: Repaired) -> IntArray:
    """Faces of the repaired mesh by the same vertices, (r, 3)."""
    assert isinstance(repaired.shape, Mesh)
    return repaired.vertex_index[repaired.original_index][repaired.shape.faces]


def _same_corners(known: IntArray, asked: IntArray) -> tuple[IntArray, IntArray]:
    """For each asked face the known one with the same vertices, (a,), and its corners, (a, 3).

    The row is -1 where there is none. A face that was flipped has its corners in another order.
    """
    # faces with equal vertices have equal labels, whatever the order of their corners
    both = np.sort(np.concatenate([known, asked]), axis=1)
    kinds, label = np.unique(both, axis=0, return_inverse=True)
    label = label.reshape(-1)
    first = np.full(len(kinds), -1, dtype=np.int64)
    # backwards, so that of several known faces the first is what remains
    first[label[: len(known)][::-1]] = np.arange(len(known))[::-1]
    rows = first[label[len(known) :]]
    corners = (known[rows][:, None, :] == asked[:, :, None]).argmax(axis=2)
    return rows, corners
