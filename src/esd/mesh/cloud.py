"""Points without faces: triangles between neighbours, by which they can be drawn."""

from __future__ import annotations

import numpy as np
from scipy.spatial import Delaunay, KDTree, QhullError

from esd.common import FloatArray, InputError, IntArray
from esd.mesh.mesh import Mesh, PointCloud
from esd.mesh.topology import oriented_outward

_NEIGHBOURS = 12
_LONGEST = 4.0  # times the usual distance of neighbours, beyond which a triangle spans a gap
_THINNEST = 0.01  # area over the longest side squared; 0.43 is equilateral


def surface_between(points: PointCloud) -> Mesh:
    """Triangles between neighbouring points, on all of the points; for pictures, not to measure by.

    Around each point, its nearest neighbours are projected to the plane that fits them best and
    triangulated there. A triangle counts if at least two of its corners find it.

    Raises
    ------
    InputError
        If there is none, as among points on a line, or too few points.
    """
    vertices = points.vertices
    if len(vertices) <= _NEIGHBOURS:
        raise InputError(f"Expected more than {_NEIGHBOURS} points; got {len(vertices)}.")
    gap, around = KDTree(vertices).query(vertices, k=_NEIGHBOURS + 1)
    # of a square, all four corners must choose the same diagonal: none is square after this
    rough = np.random.default_rng(0).normal(scale=1e-3 * np.median(gap[:, 1]), size=vertices.shape)
    rough += vertices
    found = [_fan(rough, near) for near in around]
    faces = np.sort(np.concatenate(found), axis=1)
    faces, times = np.unique(faces, axis=0, return_counts=True)
    faces = faces[times > 1]
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    longest = np.max([np.linalg.norm(p - q, axis=1) for p, q in ((a, b), (b, c), (c, a))], axis=0)
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
    faces = faces[(longest <= _LONGEST * np.median(gap[:, 1:5])) & (area > _THINNEST * longest**2)]
    if len(faces) == 0:
        raise InputError("No surface can be seen between the points; are they on a line?")
    return oriented_outward(Mesh(vertices, faces))


def _fan(vertices: FloatArray, around: IntArray) -> IntArray:
    """Triangles at the first of some points in their plane, (t, 3)."""
    local = vertices[around] - vertices[around[0]]
    across = np.linalg.svd(local, full_matrices=False)[2][:2]
    try:
        simplices = Delaunay(local @ across.T).simplices
    except QhullError:  # they lie on a line, or at one place
        return np.zeros((0, 3), dtype=np.int64)
    fan: IntArray = around[simplices[(simplices == 0).any(axis=1)]]
    return fan
