"""Vertices moved along the surface to the middle of their triangles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from esd.common import BoolArray, FloatArray, IntArray
from esd.mesh.geometry import face_areas, surface_area
from esd.mesh.mesh import Mesh
from esd.mesh.remesh.flipping import flipped, is_inverted
from esd.mesh.remesh.refinement import Refinement
from esd.mesh.surface import SurfacePoints, closest_around, interpolated, positions
from esd.mesh.topology import edge_table

POOR = 0.05  # quality of a triangle, 1 if equilateral, below which its corners are moved


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """What moving along the refinement needs.

    Parameters
    ----------
    fine
        The refinement.
    density : (n,)
        Of its vertices.
    reach : float
        Length that a unit normal counts for beside positions.
    tree
        Of the vertices' positions and normals, (n, 6).
    """

    fine: Refinement
    density: FloatArray
    reach: float
    tree: cKDTree

    @classmethod
    def on(cls, fine: Refinement, density: FloatArray, count: int) -> Motion:
        """That of a refinement whose sites are so many."""
        # nearness in position and normal keeps vertices on their side of a finger
        reach = float(np.sqrt(surface_area(fine.mesh) / count) / 2)
        tree = cKDTree(np.hstack([fine.mesh.vertices, reach * fine.normals]))
        return cls(fine, density, reach, tree)

    def closest(self, points: FloatArray, normals: FloatArray) -> SurfacePoints:
        """The closest point to each point on the faces around the vertex nearest to it."""
        vertex = self.tree.query(np.hstack([points, self.reach * normals]))[1]
        return closest_around(self.fine.mesh, self.fine.around, points, vertex)


def normals_at(fine: Refinement, points: SurfacePoints) -> FloatArray:
    """Unit normals at some points of the refinement, (p, 3), interpolated."""
    normals = interpolated(fine.normals, fine.mesh, points)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.asarray(normals / np.where(length > 0, length, 1))


def relaxed(
    motion: Motion, points: SurfacePoints, faces: IntArray, *, excess: float, everywhere: bool
) -> tuple[SurfacePoints, IntArray]:
    """Points moved along the surface to the middle of their triangles, edges flipped.

    All of them, or only the corners of poor triangles; never those on the border.
    """
    fine = motion.fine
    vertices, normals = positions(fine.mesh, points), normals_at(fine, points)
    faces = flipped(vertices, faces, normals, excess=excess)
    moving = np.full(len(vertices), everywhere)
    if not everywhere:
        moving[faces[is_poor(vertices, faces, normals)]] = True
    table = edge_table(faces, len(vertices))
    moving[table.ends[table.count == 1]] = False
    step = _middles(vertices, faces, interpolated(motion.density, fine.mesh, points)) - vertices
    step -= (step * normals).sum(axis=1, keepdims=True) * normals
    moved = motion.closest(vertices + step, normals).where(moving, points)
    before = is_inverted(vertices, faces, normals)
    for _ in range(3):  # take back what inverts a triangle
        inverted = (
            is_inverted(positions(fine.mesh, moved), faces, normals_at(fine, moved)) & ~before
        )
        moving[faces[inverted]] = False
        moved = moved.where(moving, points)
    return moved, faces


def is_poor(vertices: npt.NDArray[np.float64], faces: IntArray, normals: FloatArray) -> BoolArray:
    """Whether triangles are slivers or flipped."""
    corners = vertices[faces]
    squared = ((corners - np.roll(corners, 1, axis=1)) ** 2).sum(axis=(1, 2))
    area = face_areas(Mesh(vertices, faces))
    return np.asarray(
        (4 * np.sqrt(3) * area < POOR * squared) | is_inverted(vertices, faces, normals)
    )


def _middles(vertices: npt.NDArray[np.float64], faces: IntArray, density: FloatArray) -> FloatArray:
    """Centre of mass of the triangles at each vertex, dense ones weighing more."""
    mass = face_areas(Mesh(vertices, faces)) * density[faces].mean(axis=1) ** 2
    centre = vertices[faces].mean(axis=1)
    owner = faces.ravel()
    total = np.bincount(owner, np.repeat(mass, 3), len(vertices))
    sums = [np.bincount(owner, np.repeat(mass * x, 3), len(vertices)) for x in centre.T]
    return np.asarray(np.stack(sums, axis=1) / np.where(total > 0, total, 1)[:, None])
