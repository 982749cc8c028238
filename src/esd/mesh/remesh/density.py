"""How dense vertices should be, and in which directions edges count as long."""

from __future__ import annotations

import numpy as np
from scipy import sparse

from esd.common import FloatArray
from esd.mesh.geometry import edges, vertex_normals
from esd.mesh.mesh import Mesh
from esd.mesh.remesh.refinement import Refinement
from esd.mesh.remesh.styles import Style

SMOOTHING = 8  # averages of the curvature over neighbours before it guides the density
DENSEST = 4.0  # times shorter, or longer, than usual that edges may be


def density_and_metric(
    mesh: Mesh, fine: Refinement, style: Style
) -> tuple[FloatArray, sparse.csr_array]:
    """How much closer than usual vertices should be, and lengths of the edges that say so."""
    if style.grading == 0 and style.stretch <= 1:  # nothing depends on the curvature
        return _even(fine)
    bending = _bending(mesh)[mesh.faces].mean(axis=1)
    # an old face for each vertex of the refinement; whichever, for vertices without one
    any_face = np.minimum(fine.around.indptr[:-1], len(fine.around.indices) - 1)
    face = fine.parent[fine.around.indices[any_face]]
    curvature = np.sqrt(np.trace(bending, axis1=1, axis2=2))
    median = np.median(curvature)
    density = np.ones(len(face))
    if style.grading > 0 and median > 0:
        relative = (curvature / median).clip(1e-3) ** style.grading
        density = relative.clip(1 / DENSEST, DENSEST)[face]
    start, end = fine.edges.T
    step = fine.mesh.vertices[end] - fine.mesh.vertices[start]
    squared = (step**2).sum(axis=1)
    if style.stretch > 1:
        across = np.linalg.eigh(bending)[1][:, :, 2]  # of most bending
        crossing = (step * across[face[start]]).sum(axis=1)
        squared = squared + (style.stretch**2 - 1) * crossing**2
    length = np.sqrt(squared) * (density[start] + density[end]) / 2
    size = len(fine.mesh.vertices)
    half = sparse.coo_array((length, (start, end)), shape=(size, size))
    return density, (half + half.T).tocsr()


def _even(fine: Refinement) -> tuple[FloatArray, sparse.csr_array]:
    """As `density_and_metric`, where all edges count as they are."""
    start, end = fine.edges.T
    size = len(fine.mesh.vertices)
    length = np.linalg.norm(fine.mesh.vertices[end] - fine.mesh.vertices[start], axis=1)
    half = sparse.coo_array((length, (start, end)), shape=(size, size))
    return np.ones(size), (half + half.T).tocsr()


def _bending(mesh: Mesh) -> FloatArray:
    """Squared change of the normal per length in all directions, smoothed, (n, 3, 3)."""
    pairs, normals = edges(mesh), vertex_normals(mesh)
    step = np.diff(mesh.vertices[pairs], axis=1)[:, 0]
    change = np.diff(normals[pairs], axis=1)[:, 0]
    squared = (step**2).sum(axis=1)
    tensor = change[:, :, None] * change[:, None, :]
    tensor /= np.where(squared > 0, squared, np.inf)[:, None, None]
    size = len(mesh.vertices)
    ends = sparse.coo_array(
        (np.ones(2 * len(pairs)), (pairs.T.ravel(), np.tile(np.arange(len(pairs)), 2))),
        shape=(size, len(pairs)),
    ).tocsr()
    degree = np.maximum(ends.sum(axis=1), 1)[:, None]
    bending = ends @ tensor.reshape(-1, 9) / degree
    for _ in range(SMOOTHING):
        bending = (ends @ (ends.T @ bending)) / (2 * degree)
    return np.asarray(bending.reshape(-1, 3, 3))
