"""Measures of meshes that only tests need."""

import numpy as np
from scipy import sparse

from esd.mesh.geometry import face_areas


def signed_volume(mesh) -> float:
    """The volume inside a closed mesh, positive if its normals point outward.

    For an open one it is that of the cone over it seen from the mean of the vertices.
    """
    a, b, c = ((mesh.vertices - mesh.vertices.mean(axis=0))[mesh.faces[:, i]] for i in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)


def consistent_mass(mesh) -> sparse.csc_array:
    """Mass matrix (n, n) of linear finite elements; its sum is the area."""
    rows = mesh.faces[:, [0, 1, 2, 1, 2, 0, 2, 0, 1]].ravel()
    columns = mesh.faces[:, [0, 1, 2, 2, 0, 1, 1, 2, 0]].ravel()
    shares = face_areas(mesh)[:, None] * np.repeat([1 / 6, 1 / 12], [3, 6])
    size = len(mesh.vertices)
    return sparse.coo_array((shares.ravel(), (rows, columns)), shape=(size, size)).tocsc()
