"""Maps to points of the target's surface instead of its vertices."""

from __future__ import annotations

import numpy as np

from esd.common import FloatArray, InputError, IntArray
from esd.mesh.surface import SurfacePoints, closest_in_triangles

_CHUNK = 2**24  # numbers at a time


def precise_map(
    source: FloatArray, target: FloatArray, faces: IntArray, target_index: IntArray
) -> SurfacePoints:
    """The point of the target's faces that is nearest to each row of the source.

    `interpolated(values, target, points)` are then the target's values at the source's vertices.
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
    weights = np.full((len(source), 3), np.nan)
    step = max(1, _CHUNK // (source.shape[1] * 8 * int(count.max(initial=1))))
    for start in range(0, len(matched), step):
        rows = matched[start : start + step]
        some = count[start : start + step]
        begin = np.cumsum(some) - some
        within = np.arange(some.sum()) - np.repeat(begin, some)
        which = corner[np.repeat(first[target_index[rows]], some) + within] // 3
        at, squared = closest_in_triangles(
            np.repeat(source[rows], some, axis=0), target[faces[which]]
        )
        order = np.lexsort((squared, np.repeat(np.arange(len(rows)), some)))
        best = order[begin]  # the first of each vertex has the smallest distance
        face[rows], weights[rows] = which[best], at[best]
    return SurfacePoints(face, weights)
