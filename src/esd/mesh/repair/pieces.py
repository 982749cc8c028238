"""Loose pieces: which is the ground, and what becomes of the vertices of those left out."""

from __future__ import annotations

import numpy as np
from scipy.spatial import KDTree

from esd.common import BoolArray, FloatArray, IntArray
from esd.mesh.geometry import face_areas
from esd.mesh.mesh import Mesh
from esd.mesh.repair.arrays import diagonal
from esd.mesh.topology import piece_of_faces

NEAR = 0.05
"""Of the kept piece's bounding diagonal: vertices of other pieces within it have a stand-in."""

_GROUND = 0.05  # share of the area that the ground has at least
_FLAT = 0.02  # of its size or of the height above it, that the ground is off its plane at most


def stand_ins(vertices: FloatArray, *, kept: IntArray, dropped: IntArray) -> IntArray:
    """The kept vertex nearest to each dropped one, (d,), if it is near; −1 otherwise.

    Parameters
    ----------
    vertices : (n, 3)
    kept, dropped : (k,) and (d,)
        Vertices of the piece that is kept, and of the others.
    """
    if len(dropped) == 0:
        return np.zeros(0, dtype=np.int64)
    limit = NEAR * diagonal(vertices[kept])
    distance, nearest = KDTree(vertices[kept]).query(
        vertices[dropped], distance_upper_bound=np.nextafter(limit, np.inf)
    )
    # where there is none within the bound, the distance is infinite and the index beyond the last
    return np.where(np.isfinite(distance), np.append(kept, -1)[nearest], -1)


def is_ground(mesh: Mesh) -> BoolArray:
    """Whether each face, (m,), is of the one flat piece that all other pieces lie on one side of.

    A box of loose sides has several such pieces, and none of them is its ground.
    """
    piece = piece_of_faces(mesh)
    area = np.bincount(piece, weights=face_areas(mesh))
    sides = [
        number
        for number in np.flatnonzero(area >= _GROUND * area.sum())
        if len(area) > 1 and _is_side(mesh, piece == number)
    ]
    return np.asarray(piece == sides[0] if len(sides) == 1 else np.zeros(len(piece), dtype=bool))


def _is_side(mesh: Mesh, chosen: BoolArray) -> bool:
    """Whether some faces, (m,), are flat and all others on one side of them."""
    points, others = (mesh.vertices[np.unique(mesh.faces[which])] for which in (chosen, ~chosen))
    middle = points.mean(axis=0)
    _, extents, axes = np.linalg.svd(points - middle, full_matrices=False)
    height = (others - middle) @ axes[2]
    off = _FLAT * max(float(extents[0]) / len(points) ** 0.5, float(np.ptp(height)))
    is_flat = np.abs((points - middle) @ axes[2]).max() <= off
    # a piece beside others in its own plane is no ground of theirs
    is_beside = height.min() > -off or height.max() < off
    return bool(is_flat and is_beside and np.ptp(height) > 2 * off)
