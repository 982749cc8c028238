"""Points of a surface: where they lie on its faces, values there, and closest points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import sparse

from esd.common import BoolArray, FloatArray, IntArray
from esd.mesh.mesh import Mesh

WALK = 3  # vertices further on that the closest point may lie

_ROWS = 4096


@dataclass(frozen=True, slots=True, eq=False)
class SurfacePoints:
    """p points on the faces of a mesh.

    Parameters
    ----------
    face : (p,)
        The face of each point; -1 for none.
    weights : (p, 3)
        Barycentric weights of the corners of the face, which sum to one; NaN for none.
    """

    face: IntArray
    weights: FloatArray

    def where(self, chosen: BoolArray, other: SurfacePoints) -> SurfacePoints:
        """These points where chosen, (p,), the others elsewhere."""
        return SurfacePoints(
            np.where(chosen, self.face, other.face),
            np.where(chosen[:, None], self.weights, other.weights),
        )


def at_vertices(mesh: Mesh, vertices: IntArray) -> SurfacePoints:
    """The points at some vertices, (p,); none for -1 and for vertices without a face."""
    corner_of = np.full(len(mesh.vertices) + 1, -1)  # one more, for -1
    corner_of[mesh.faces.ravel()] = np.arange(mesh.faces.size)
    corner = corner_of[vertices]
    # corner 3 f + c is corner c of face f; -1 // 3 is -1
    weights = np.where(corner[:, None] >= 0, np.eye(3)[corner % 3], np.nan)
    return SurfacePoints(corner // 3, weights)


def interpolated(values: FloatArray, mesh: Mesh, points: SurfacePoints) -> FloatArray:
    """Values at some points, (p, …), of values at the mesh's vertices, (n, …); NaN for none.

    Values that are not finite count only at corners that have a weight.
    """
    corners = mesh.faces[points.face]
    result = np.zeros((len(corners), *values.shape[1:]))
    is_finite = bool(np.isfinite(values).all())
    for corner in range(3):  # one after another, since all at once may not fit into memory
        weight = points.weights[:, corner].reshape(-1, *[1] * (values.ndim - 1))
        part = values[corners[:, corner]]
        if not is_finite:
            part = np.where(weight == 0, 0.0, part)  # 0 · ∞ is no number
        result += weight * part
    result[points.face < 0] = np.nan
    return result


def positions(mesh: Mesh, points: SurfacePoints) -> npt.NDArray[np.float64]:
    """Where some points lie in space, (p, 3); NaN for none."""
    return interpolated(mesh.vertices, mesh, points).astype(np.float64)


def nearest_vertices(mesh: Mesh, points: SurfacePoints) -> IntArray:
    """The corner of most weight of each point, (p,); -1 for none."""
    corner = np.nan_to_num(points.weights).argmax(axis=1)
    return np.where(points.face >= 0, mesh.faces[points.face, corner], -1)


def faces_around(faces: IntArray) -> sparse.csr_array:
    """Faces of each vertex, as the columns of its row."""
    # corner 3 f + c is one of face f
    corners = (np.arange(3 * len(faces)) // 3, faces.ravel())
    return sparse.coo_array((np.ones(3 * len(faces)), corners[::-1])).tocsr()


def closest_points(mesh: Mesh, queries: FloatArray, near: IntArray) -> SurfacePoints:
    """The point of a mesh closest to each of some points in space.

    It is sought among the faces at a vertex, and on among those at another corner as long as it
    lies opposite to the vertex.

    Parameters
    ----------
    queries : (p, 3)
    near : (p,)
        A vertex of the mesh near each of them, with a face.
    """
    around = faces_around(mesh.faces)
    found = closest_around(mesh, around, queries, near)
    moving, start = np.arange(len(queries)), near
    for _ in range(WALK):
        corners = mesh.faces[found.face[moving]]
        opposite = (found.weights[moving] * (corners == start[:, None])).sum(axis=1) == 0
        corner = found.weights[moving].argmax(axis=1)
        moving, start = moving[opposite], corners[opposite, corner[opposite]]
        further = closest_around(mesh, around, queries[moving], start)
        found.face[moving], found.weights[moving] = further.face, further.weights
    return found


def closest_around(
    mesh: Mesh, around: sparse.csr_array, queries: FloatArray, vertex: IntArray
) -> SurfacePoints:
    """The closest point to each of some points in space, on the faces at a vertex, (p,), of each.

    Parameters
    ----------
    around
        The mesh's `faces_around`.
    """
    if len(queries) > _ROWS:  # some at a time: arrays that stay in the cache of the processor
        parts = [
            closest_around(mesh, around, queries[i : i + _ROWS], vertex[i : i + _ROWS])
            for i in range(0, len(queries), _ROWS)
        ]
        return SurfacePoints(
            np.concatenate([part.face for part in parts]),
            np.concatenate([part.weights for part in parts]),
        )
    first, last = around.indptr[vertex], around.indptr[vertex + 1]
    face = np.empty(len(queries), dtype=np.int64)
    weights = np.zeros((len(queries), 3))
    least = np.full(len(queries), np.inf)
    # in turn the first face at each vertex, the second, …; where there are no more, the last again
    for turn in range(int((last - first).max(initial=0))):
        candidate = around.indices[np.minimum(first + turn, last - 1)]
        at, squared = closest_in_triangles(queries, mesh.vertices[mesh.faces[candidate]])
        closer = squared < least
        face[closer], weights[closer], least[closer] = (
            candidate[closer],
            at[closer],
            squared[closer],
        )
    return SurfacePoints(face, weights)


def barycentric_weights(points: FloatArray, triangles: FloatArray) -> FloatArray:
    """Barycentric weights of points projected to the planes of triangles, (k, 3).

    Parameters
    ----------
    points : (k, 3)
    triangles : (k, 3, 3)
        Corners of the triangle of each point; those without area give NaN.
    """
    a, b, c = triangles.transpose(1, 0, 2)
    normal = np.cross(b - a, c - a)
    squared = (normal**2).sum(axis=1)
    second = (np.cross(points - a, c - a) * normal).sum(axis=1)
    third = (np.cross(b - a, points - a) * normal).sum(axis=1)
    weights = np.stack([squared - second - third, second, third], axis=1)
    return np.asarray(weights / np.where(squared == 0, np.nan, squared)[:, None])


def closest_in_triangles(
    points: FloatArray, triangles: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Barycentric weights, (k, 3), of the closest points of triangles, and squared distances, (k,).

    Parameters
    ----------
    points : (k, d)
    triangles : (k, 3, d)
        Corners of the triangle of each point. Where d is three, cross products are taken, which
        lose fewer digits in slivers than the inner products that other dimensions need.
    """
    if points.shape[1] != 3:
        return _closest_by_inner_products(points, triangles)
    # coordinate by coordinate: sums over the short axis of (k, 3) take many times as long
    point, corners = points.T.copy(), triangles.transpose(1, 2, 0).copy()  # (3, k), (3, 3, k)
    a, b, c = corners
    normal = _cross(b - a, c - a)
    squared = _dot(normal, normal)
    known = np.where(squared == 0, np.nan, squared)
    second = _dot(_cross(point - a, c - a), normal) / known
    third = _dot(_cross(b - a, point - a), normal) / known
    weights = np.stack([(squared / known) - second - third, second, third])  # (3, k)
    inside = (weights >= 0).all(axis=0)
    least = np.where(inside, _squared_gap(weights, point, corners), np.inf)
    for corner in range(3):  # the side opposite to each
        first, other = (corner + 1) % 3, (corner + 2) % 3
        start, side = corners[first], corners[other] - corners[first]
        length = _dot(side, side)
        share = _dot(point - start, side) / np.where(length > 0, length, 1)
        share = share.clip(0, 1)
        away = start + share * side - point
        gap = _dot(away, away)
        closer = gap < least
        least = np.where(closer, gap, least)
        weights[corner] = np.where(closer, 0, weights[corner])
        weights[first] = np.where(closer, 1 - share, weights[first])
        weights[other] = np.where(closer, share, weights[other])
    # of the points as they are given, so that equal ones of two triangles are equally far
    return weights.T.copy(), _squared_gap(weights, point, corners)


def _cross(u: FloatArray, v: FloatArray) -> FloatArray:
    """Cross products, (3, k), of vectors (3, k)."""
    return np.stack(
        [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]]
    )


def _dot(u: FloatArray, v: FloatArray) -> FloatArray:
    """Inner products, (k,), of vectors (3, k)."""
    return np.asarray(u[0] * v[0] + u[1] * v[1] + u[2] * v[2])


def _squared_gap(weights: FloatArray, point: FloatArray, corners: FloatArray) -> FloatArray:
    """Squared distances, (k,), of points (3, k) from those at weights of corners (3, 3, k)."""
    gap = weights[0] * corners[0] + weights[1] * corners[1] + weights[2] * corners[2] - point
    return _dot(gap, gap)


def _closest_by_inner_products(
    points: FloatArray, triangles: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """As `closest_in_triangles`, in any dimension.

    The closest of the foot of the perpendicular, where it lies inside, and the closest points of
    the three sides; s and t are the weights of the second and the third corner.
    """
    a, b, c = triangles.transpose(1, 0, 2)
    u, v, w = b - a, c - a, points - a
    uu, uv, vv, uw, vw = (
        np.einsum("kd,kd->k", *pair) for pair in ((u, u), (u, v), (v, v), (u, w), (v, w))
    )
    tiny = np.finfo(float).tiny
    area = np.maximum(uu * vv - uv**2, tiny)
    s, t = (vv * uw - uv * vw) / area, (uu * vw - uv * uw) / area
    inside = (s >= 0) & (t >= 0) & (s + t <= 1)
    along_u = np.clip(uw / np.maximum(uu, tiny), 0, 1)
    along_v = np.clip(vw / np.maximum(vv, tiny), 0, 1)
    across = uu - 2 * uv + vv
    along = np.clip((vw - uw - uv + uu) / np.maximum(across, tiny), 0, 1)  # from b to c
    zero = np.zeros_like(s)
    found = np.stack(
        [
            np.stack([np.where(inside, s, 0.0), along_u, zero, 1 - along]),
            np.stack([np.where(inside, t, 0.0), zero, along_v, along]),
        ]
    )
    squared = (
        np.einsum("kd,kd->k", w, w)
        - 2 * (found[0] * uw + found[1] * vw)
        + found[0] ** 2 * uu
        + 2 * found[0] * found[1] * uv
        + found[1] ** 2 * vv
    )
    best = squared.argmin(axis=0), np.arange(len(s))
    s, t = found[0][best], found[1][best]
    return np.stack([1 - s - t, s, t], axis=1), np.maximum(squared[best], 0.0)
