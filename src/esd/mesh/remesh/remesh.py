"""The same surface with other triangles, in several styles, and which points correspond.

The method is the dual of a geodesic Voronoi diagram. Sites are spread over a refinement of the
surface, every vertex of the refinement goes to its nearest site along the surface, and three sites
whose cells meet become a triangle. Where the cells are too large to follow the surface (a cell
around a whole finger, say), the dual would not be a manifold: sites are added there until it is.
Then edges are flipped and vertices moved along the surface until the triangles are as wished. New
vertices lie on the old surface, and it is known where.

Only NumPy and SciPy are needed. The small mesh libraries there are decimate, which leaves traces
of the old triangles and sometimes edges of four faces, or move vertices off the surface without
saying where they came from.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from esd.common import InputError, IntArray
from esd.mesh.geometry import (
    adjacency,
    edges,
    face_areas,
    is_consistently_oriented,
    surface_area,
)
from esd.mesh.mesh import Mesh
from esd.mesh.remesh.density import density_and_metric
from esd.mesh.remesh.dual import dual, spread_sites
from esd.mesh.remesh.flipping import flipped
from esd.mesh.remesh.refinement import refined
from esd.mesh.remesh.relaxing import Motion, is_poor, normals_at, relaxed
from esd.mesh.remesh.styles import STYLES, Style
from esd.mesh.surface import SurfacePoints, at_vertices, closest_in_triangles, positions
from esd.mesh.topology import edge_table, fan_count

FINENESS = 2.0  # mean distance of sites over longest edge of the refinement
SLIVER = 2.5  # sum of cotangents opposite to an edge, below minus which its triangles are slivers
REPAIR_ROUNDS = 4  # rounds of moving the corners of poor triangles


@dataclass(frozen=True, slots=True, eq=False)
class Remeshed:
    """A surface with new triangles; n new vertices, p old ones.

    Parameters
    ----------
    mesh : Mesh
        The new mesh, its vertices on the old surface.
    points
        Where each new vertex lies on the old mesh.
    nearest : (p,)
        New vertex nearest to each old vertex, -1 for old vertices without a face.
    """

    mesh: Mesh
    points: SurfacePoints
    nearest: IntArray


def remesh(mesh: Mesh, vertex_count: int, *, style: str | Style = "graded", seed: int) -> Remeshed:
    """The surface with about `vertex_count` vertices in a style.

    The new mesh has the topology and the orientation of the old one. It may have some vertices
    more than asked for where they are needed to follow the surface. Equal seeds give equal meshes.

    Parameters
    ----------
    mesh : Mesh
        A manifold, consistently oriented mesh, closed or open.
    vertex_count : int
        At least 4.
    style
        A name in `STYLES`, or a `Style`.
    seed : int
        Of the places of the vertices.

    Raises
    ------
    InputError
        If the count is too small, the style unknown, or the mesh not an oriented manifold.
    """
    style = _checked(mesh, vertex_count, style)
    spacing = np.sqrt(2 / np.sqrt(3) * surface_area(mesh) / vertex_count)
    fine = refined(mesh, spacing / FINENESS)
    density, metric = density_and_metric(mesh, fine, style)
    sites = spread_sites(fine, density, metric, vertex_count, style.spreading, seed)
    sites, cell, faces = dual(fine, metric, sites)
    excess = 0.0 if style.relaxing else SLIVER
    motion = Motion.on(fine, density, len(sites))
    points = at_vertices(fine.mesh, sites)
    for _ in range(style.relaxing):
        points, faces = relaxed(motion, points, faces, excess=excess, everywhere=True)
    for _ in range(REPAIR_ROUNDS):
        if not is_poor(positions(fine.mesh, points), faces, normals_at(fine, points)).any():
            break
        points, faces = relaxed(motion, points, faces, excess=excess, everywhere=False)
    vertices = positions(fine.mesh, points)
    faces = flipped(vertices, faces, normals_at(fine, points), excess=excess)
    new = Mesh(vertices, faces)
    face = fine.parent[points.face]
    weights, _ = closest_in_triangles(vertices, mesh.vertices[mesh.faces[face]])
    return Remeshed(
        mesh=new,
        points=SurfacePoints(face, weights),
        nearest=_walked(new, mesh.vertices, cell[: len(mesh.vertices)]),
    )


def _checked(mesh: Mesh, vertex_count: int, style: str | Style) -> Style:
    if vertex_count < 4:
        raise InputError(f"`vertex_count` must be at least 4; got {vertex_count}.")
    table = edge_table(mesh.faces, len(mesh.vertices))
    fans = fan_count(mesh.faces, table, len(mesh.vertices))
    if not is_consistently_oriented(mesh) or fans.max() > 1:
        raise InputError(
            "The mesh must be a consistently oriented manifold to be remeshed; repair it first."
        )
    if (face_areas(mesh) == 0).all():
        raise InputError("The mesh has no area; there is no surface to remesh.")
    if isinstance(style, Style):
        return style
    if style not in STYLES:
        raise InputError(f"`style` must be one of {', '.join(STYLES)}; got '{style}'.")
    return STYLES[style]


def _walked(mesh: Mesh, points: npt.NDArray[Any], start: IntArray) -> IntArray:
    """Nearest vertex to each point that is reached by descending from a vertex, -1 from -1."""
    neighbours = adjacency(edges(mesh), len(mesh.vertices))
    first, degree = neighbours.indptr[:-1], np.diff(neighbours.indptr)
    current = start.copy()
    while True:
        best, least = current, ((mesh.vertices[current] - points) ** 2).sum(axis=1)
        # in turn the first neighbour of each vertex, the second, …; at the end the last again
        for turn in range(degree.max()):
            slot = np.minimum(first[current] + turn, first[current] + degree[current] - 1)
            neighbour = neighbours.indices[slot]
            gap = ((mesh.vertices[neighbour] - points) ** 2).sum(axis=1)
            best = np.where(gap < least, neighbour, best)
            least = np.minimum(gap, least)
        best = np.where(start < 0, -1, best)
        if (best == current).all():
            return best
        current = best
