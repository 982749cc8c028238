"""Maps to points of the target's surface instead of its vertices."""

from __future__ import annotations

import numpy as np

from esd.common import FloatArray, InputError, IntArray
from esd.matching.transfer import Places

_CHUNK = 2**24  # numbers at a time


def precise_map(
    source: FloatArray, target: FloatArray, faces: IntArray, target_index: IntArray
) -> Places:
    """The point of the target's faces that is nearest to each row of the source.

    `carried_values(values, target, places)` are then the target's values at the source's vertices.
    Rows are interpolated linearly over faces; those at the matched vertex are searched.

    Parameters
    ----------
    source, target : (n, d) and (m, d)
        Rows such as `esd.matching.refine.joint_rows`.
    faces : (f, 3)
        Of the target.
    target_index : (n,)
        The nearest vertex of each source vertex; -1 for none.

    Raises
    ------
    InputError
        If a matched vertex has no face.

    References
    ----------
    Ezuz, Ben-Chen 2017, *Deblurring and denoising of maps between shapes*, section 5, who search
    all faces.
    """
    corner = np.argsort(faces.ravel(), kind="stable")
    first = np.searchsorted(faces.ravel()[corner], np.arange(len(target) + 1))
    matched = np.flatnonzero(target_index >= 0)
    count = np.diff(first)[target_index[matched]]
    if not count.all():
        lone = target_index[matched[count == 0][0]]
        raise InputError(f"Target vertex {lone} is matched and has no face.")
    face = np.full(len(source), -1, dtype=np.int64)
    barycentric = np.full((len(source), 3), np.nan)
    step = max(1, _CHUNK // (source.shape[1] * 8 * int(count.max(initial=1))))
    for start in range(0, len(matched), step):
        rows = matched[start : start + step]
        some = count[start : start + step]
        begin = np.cumsum(some) - some
        within = np.arange(some.sum()) - np.repeat(begin, some)
        which = corner[np.repeat(first[target_index[rows]], some) + within] // 3
        a, b, c = (target[faces[which, i]] for i in range(3))
        weights, squared = _nearest_in_triangles(np.repeat(source[rows], some, axis=0), a, b, c)
        order = np.lexsort((squared, np.repeat(np.arange(len(rows)), some)))
        best = order[begin]  # the first of each vertex has the smallest distance
        face[rows], barycentric[rows] = which[best], weights[best]
    return Places(face, barycentric)


def _nearest_in_triangles(
    point: FloatArray, a: FloatArray, b: FloatArray, c: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Barycentric coordinates (k, 3) of the nearest points in triangles, and squared distances.

    The nearest of the foot of the perpendicular, where it lies inside, and the nearest points of
    the three sides.
    """
    u, v, w = b - a, c - a, point - a
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
    places = np.stack(
        [
            np.stack([np.where(inside, s, 0.0), along_u, zero, 1 - along]),
            np.stack([np.where(inside, t, 0.0), zero, along_v, along]),
        ]
    )
    squared = (
        np.einsum("kd,kd->k", w, w)
        - 2 * (places[0] * uw + places[1] * vw)
        + places[0] ** 2 * uu
        + 2 * places[0] * places[1] * uv
        + places[1] ** 2 * vv
    )
    best = squared.argmin(axis=0), np.arange(len(s))
    s, t = places[0][best], places[1][best]
    return np.stack([1 - s - t, s, t], axis=1), np.maximum(squared[best], 0.0)
