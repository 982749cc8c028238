"""Gradients of functions on a mesh, in the tangent planes of its vertices."""

from __future__ import annotations

import numpy as np
from scipy import sparse

from esd.mesh.geometry import face_normals, unit, vertex_normals
from esd.mesh.mesh import Mesh

_DEGENERATE = 1e-3  # of the mean area, below which a face has no normal to speak of
_AREA_FLOOR = 0.1  # of the mean area around a vertex, below which it counts as if it had that


def gradient_operator(mesh: Mesh) -> sparse.csr_array:
    """The matrix (n, n), complex, from values at the vertices to gradients, per unit of length.

    The gradient of the linear function on each face is averaged around each vertex by area. Its
    real and imaginary parts are along two orthogonal directions in the tangent plane, the second
    a quarter turn from the first as seen from outside; the first is arbitrary.
    """
    vertices, faces = mesh.vertices, mesh.faces
    corners, normals = vertices[faces], face_normals(mesh)
    double = np.linalg.norm(normals, axis=1)
    normals /= np.maximum(double, np.finfo(float).tiny)[:, None]
    normals[double < _DEGENERATE * double.mean()] = 0.0
    around = np.bincount(faces.ravel(), np.repeat(double, 3), minlength=len(vertices))
    around = np.maximum(around, _AREA_FLOOR * around.mean())

    upward = vertex_normals(mesh)
    along = np.eye(3)[np.abs(upward).argmin(axis=1)]  # the axis farthest from the normal
    first = unit(np.cross(upward, along))
    second = np.cross(upward, first)

    rows, columns, values = [], [], []
    for i in range(3):
        # of the hat function of corner i, times twice the area: the opposite side, turned
        gradient = np.cross(normals, corners[:, i - 1] - corners[:, i - 2])
        for j in range(3):
            at = faces[:, j]
            rows.append(at)
            columns.append(faces[:, i])
            parts = [np.einsum("fd,fd->f", frame[at], gradient) for frame in (first, second)]
            values.append((parts[0] + 1j * parts[1]) / around[at])
    entries = (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns)))
    size = (len(vertices), len(vertices))
    return sparse.coo_array(entries, shape=size).tocsr()
