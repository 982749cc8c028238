"""Edges flipped for triangles that are nearly Delaunay."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from esd.common import BoolArray, FloatArray, IntArray
from esd.mesh.topology import edge_table


def is_inverted(
    vertices: npt.NDArray[np.float64], faces: IntArray, normals: FloatArray
) -> BoolArray:
    """Whether triangles face against the normals of all their corners, or have no area."""
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    normal = np.cross(b - a, c - a)
    return np.asarray((np.einsum("mk,mik->mi", normal, normals[faces]) <= 0).all(axis=1))


def flipped(
    vertices: npt.NDArray[np.float64],
    faces: IntArray,
    normals: FloatArray,
    *,
    excess: float,
    rounds: int = 8,
) -> IntArray:
    """Faces with edges flipped whose opposite cotangents sum to less than minus `excess`.

    Zero gives Delaunay triangles. Edges stay where the surface is sharp, or where a flip would
    double an edge or invert a triangle.
    """
    count = len(vertices)
    for _ in range(rounds):
        table = edge_table(faces, count)
        inner = table.inner_sides()
        falling = table.start[inner[:, 0]] > table.end[inner[:, 0]]
        one, two = np.where(falling[:, None], inner[:, ::-1], inner).T  # a < b, one running a to b
        a, b = table.start[one], table.end[one]
        c, d = faces.ravel()[one], faces.ravel()[two]  # opposite to the edge
        weight = _cotangent(vertices, c, a, b) + _cotangent(vertices, d, a, b)
        wanted = np.flatnonzero(weight < -excess - 1e-9)
        low, high = np.minimum(c, d)[wanted], np.maximum(c, d)[wanted]
        wanted = wanted[~np.isin(low * count + high, table.ends @ [count, 1])]
        a, b, c, d = (x[wanted] for x in (a, b, c, d))
        left, right = np.stack([c, a, d], axis=1), np.stack([c, d, b], axis=1)
        safe = ~(is_inverted(vertices, left, normals) | is_inverted(vertices, right, normals))
        flat = _cosine(vertices, np.stack([c, a, b], axis=1), np.stack([d, b, a], axis=1)) > 0.5
        chosen = np.flatnonzero(safe & flat)
        if len(chosen) == 0:
            break
        # of flips that touch the same triangle, the most needed is done
        chosen = chosen[np.argsort(weight[wanted[chosen]], kind="stable")]
        touched = np.stack([one[wanted], two[wanted]], axis=1)[chosen] // 3
        rank = np.full(len(faces), len(chosen))
        np.minimum.at(rank, touched, np.arange(len(chosen))[:, None])
        free = (rank[touched] == np.arange(len(chosen))[:, None]).all(axis=1)
        chosen, touched = chosen[free], touched[free]
        pair = np.minimum(c, d)[chosen] * count + np.maximum(c, d)[chosen]
        _, single = np.unique(pair, return_index=True)
        faces = faces.copy()
        faces[touched[single, 0]] = left[chosen[single]]
        faces[touched[single, 1]] = right[chosen[single]]
    return faces


def _cotangent(vertices: FloatArray, corner: IntArray, a: IntArray, b: IntArray) -> FloatArray:
    """Cotangent of the angle at a corner between two other vertices; huge where it is flat."""
    one, two = vertices[a] - vertices[corner], vertices[b] - vertices[corner]
    area = np.linalg.norm(np.cross(one, two), axis=1)
    return np.asarray((one * two).sum(axis=1) / np.maximum(area, np.finfo(float).tiny))


def _cosine(vertices: FloatArray, first: IntArray, second: IntArray) -> FloatArray:
    """Cosine of the angle between the normals of triangles; 1 where one has no area."""
    one, two = (
        np.cross(vertices[f[:, 1]] - vertices[f[:, 0]], vertices[f[:, 2]] - vertices[f[:, 0]])
        for f in (first, second)
    )
    length = np.linalg.norm(one, axis=1) * np.linalg.norm(two, axis=1)
    product = (one * two).sum(axis=1)
    return np.divide(product, length, out=np.ones(len(one)), where=length > 0)
