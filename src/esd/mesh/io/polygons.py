"""Polygons cut into triangles."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from esd.common import BoolArray, FloatArray, IntArray

_log = logging.getLogger(__name__)


class Triangles(NamedTuple):
    """Triangles of polygons whose corners are in one flat list.

    Parameters
    ----------
    corners : (m, 3)
        Places in the flat list.
    polygon : (m,)
        The polygon of each triangle.
    """

    corners: IntArray
    polygon: IntArray


def triangulated(
    vertices: npt.NDArray[Any], corners: npt.NDArray[Any], counts: npt.NDArray[Any]
) -> Triangles:
    """Polygons cut into triangles, in their order.

    Convex ones are cut from their first corner, concave ones by ear clipping (mapbox_earcut, on
    the plane of their mean normal). Polygons of fewer than three corners give none.

    Parameters
    ----------
    vertices : (n, 3)
    corners : (c,)
        Vertices of all polygons, one after the other. They may be beyond the last vertex: then
        the polygon is taken to be convex.
    counts : (p,)
        Number of corners of each polygon.
    """
    counts = np.asarray(counts, dtype=np.int64)
    starts = np.cumsum(counts) - counts
    each = np.maximum(counts - 2, 0)
    polygon = np.repeat(np.arange(len(counts)), each)
    # number of each triangle in its polygon: (0, k + 1, k + 2) of its corners
    number = np.arange(len(polygon)) - np.repeat(np.cumsum(each) - each, each)
    first = starts[polygon]
    result = np.stack([first, first + number + 1, first + number + 2], axis=1)
    begins = np.cumsum(each) - each  # its first triangle
    for size in np.unique(counts[counts > 3]).tolist():
        chosen = np.flatnonzero(counts == size)
        at = starts[chosen, None] + np.arange(size)
        rings = corners[at]
        known = ((rings >= 0) & (rings < len(vertices))).all(axis=1)
        chosen, at, rings = chosen[known], at[known], rings[known]
        places = np.asarray(vertices, dtype=float)[rings]
        normals = _normals(places)
        for k in np.flatnonzero(_is_concave(places, normals)):
            ears = _ears(places[k], normals[k])
            if len(ears) == size - 2:
                result[begins[chosen[k]] : begins[chosen[k]] + size - 2] = at[k][ears]
    return Triangles(result, polygon)


def polygon_count(path: Path, counts: npt.NDArray[Any]) -> int:
    """Number of the polygons that have three corners or more; the log says how many have fewer.

    Parameters
    ----------
    path
        The file that they are in.
    counts : (p,)
        Number of corners of each polygon.
    """
    fewer = int(np.count_nonzero(np.asarray(counts) < 3))
    if fewer:
        faces = "1 face has" if fewer == 1 else f"{fewer} faces have"
        _log.warning("'%s': %s fewer than three corners; is the file cut short?", path, faces)
    return len(counts) - fewer


def strip_triangles(strip: IntArray) -> IntArray:
    """Triangles (m, 3) of a strip (c,), whose corners of -1, which end strips, are left out."""
    corners = strip[strip >= 0]
    faces = np.stack([corners[:-2], corners[1:-1], corners[2:]], axis=1)
    faces[1::2] = faces[1::2, [1, 0, 2]]  # every other triangle is turned round
    # a strip goes round a corner by a triangle that has a corner twice
    repeated = (faces == np.roll(faces, 1, axis=1)).any(axis=1)
    return faces[~repeated]


def _normals(places: FloatArray) -> FloatArray:
    """Twice the vector area of each polygon (Newell), (p, 3), from its corners (p, s, 3)."""
    with np.errstate(all="ignore"):
        relative = places - places[:, :1]
        return np.asarray(np.cross(relative, np.roll(relative, -1, axis=1)).sum(axis=1))


def _is_concave(places: FloatArray, normals: FloatArray) -> BoolArray:
    """Whether a polygon turns against its normal at some corner, more than by rounding."""
    with np.errstate(all="ignore"):
        sides = np.roll(places, -1, axis=1) - places
        turns = np.cross(np.roll(sides, 1, axis=1), sides) @ normals[:, :, None]
        size = np.einsum("pi,pi->p", normals, normals)
        return np.asarray((turns[:, :, 0] < -1e-9 * size[:, None]).any(axis=1) & np.isfinite(size))


def _ears(places: FloatArray, normal: FloatArray) -> IntArray:
    """Triangles (s - 2, 3) of a concave polygon, oriented as it is; fewer if it cuts itself."""
    from mapbox_earcut import triangulate_float64

    # leave out the axis along which the polygon is seen best, keeping its sense of rotation
    axis = int(np.abs(normal).argmax())
    kept = [(axis + 1) % 3, (axis + 2) % 3]
    if normal[axis] < 0:
        kept.reverse()
    flat = np.ascontiguousarray(places[:, kept])
    flat = (flat - flat.min(axis=0)) / np.ptp(flat, axis=0).max()
    ears = triangulate_float64(flat, np.array([len(flat)], dtype=np.uint32)).reshape(-1, 3)
    ears = ears.astype(np.int64)
    first, second, third = (flat[ears[:, k]] for k in range(3))
    (a, b), (c, d) = (second - first).T, (third - first).T
    ears[a * d < b * c] = ears[a * d < b * c][:, ::-1]
    return ears
