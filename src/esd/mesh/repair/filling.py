"""Holes filled with patches that continue the surface around them."""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import spsolve

from esd.common import FloatArray, IntArray
from esd.mesh.geometry import adjacency, edges, surface_area
from esd.mesh.mesh import Mesh
from esd.mesh.topology import edge_table, rims

_RINGS = 20  # of a patch at the most; the largest patches of very dense meshes are coarser


def holes_filled(mesh: Mesh, *, shorter_than: float) -> tuple[Mesh, IntArray]:
    """The mesh with small holes filled, and for each new vertex, (new,), one on the rim near it.

    A patch has rings of vertices about as far apart as those of the rim, which lie where a thin
    plate held by the surface around would rest, after Liepa (Filling Holes in Meshes, 2003). New
    vertices come after the old ones. A rim that is no simple loop stays.

    Parameters
    ----------
    mesh
        Must be consistently oriented.
    shorter_than
        Length of the rims, in units of the square root of the area.
    """
    loops = _loops(mesh, shorter_than * surface_area(mesh) ** 0.5)
    count = len(mesh.vertices)
    faces, near = [mesh.faces], []
    for loop in loops:
        patch, parents = _patch(mesh.vertices[loop])
        new = count + np.arange(len(parents))
        faces.append(np.concatenate([loop, new])[patch])
        near.append(loop[parents])
        count += len(parents)
    if not loops:
        return mesh, np.zeros(0, dtype=np.int64)
    rim = np.concatenate(near)
    vertices = np.concatenate([mesh.vertices, mesh.vertices[rim]])
    filled = Mesh(vertices, np.concatenate(faces))
    return (_at_rest(filled, len(mesh.vertices)) if len(rim) else filled), rim


def _loops(mesh: Mesh, longest: float) -> list[IntArray]:
    """The vertices along each rim up to a length, so that its hole lies to their left."""
    directed, length = rims(mesh, edge_table(mesh.faces, len(mesh.vertices)))
    directed = directed[length[directed[:, 2]] < longest]
    directed = directed[np.argsort(directed[:, 2], kind="stable")]
    loops = []
    for rim in np.split(directed, np.flatnonzero(np.diff(directed[:, 2])) + 1):
        # a face has its rim edge the other way round
        following = dict(zip(rim[:, 1].tolist(), rim[:, 0].tolist(), strict=True))
        loop = [*following][:1]
        while loop and (vertex := following.pop(loop[-1], None)) not in (None, loop[0]):
            loop.append(vertex)
        if len(loop) == len(rim) > 2 and vertex == loop[0]:
            loops.append(np.array(loop))
    return loops


def _patch(points: FloatArray) -> tuple[IntArray, IntArray]:
    """Faces of a disc with a given boundary (k, 3), and the boundary vertex near each new one.

    Vertices from 0 to k − 1 are the boundary, the others are new.
    """
    outer = np.arange(len(points))
    if len(outer) == 3:
        return outer[None], np.zeros(0, dtype=np.int64)
    radius = np.linalg.norm(points - points.mean(axis=0), axis=1).mean()
    step = np.linalg.norm(points - np.roll(points, 1, axis=0), axis=1).mean()
    rings = min(_RINGS, max(1, round(radius / max(step, np.finfo(float).tiny))))
    faces, parents, count = [], [], len(points)
    for ring in range(1, rings):
        size = max(3, round(len(points) * (1 - ring / rings)))
        inner = count + np.arange(size)
        faces.append(_between(outer, inner))
        # the boundary vertex at the same share of the way around
        parents.append(np.arange(size) * len(points) // size)
        outer, count = inner, count + size
    middle = np.full(len(outer), count)
    faces.append(np.stack([outer, np.roll(outer, -1), middle], axis=1))
    parents.append(np.zeros(1, dtype=np.int64))
    return np.concatenate(faces), np.concatenate(parents)


def _between(outer: IntArray, inner: IntArray) -> IntArray:
    """Faces of the strip between two rings of vertices that begin side by side."""
    a, b = len(outer), len(inner)
    ends = np.concatenate([np.arange(1, a + 1) / a, np.arange(1, b + 1) / b])
    along_outer = np.argsort(ends, stable=True) < a
    i: IntArray = np.cumsum(along_outer) - along_outer  # steps taken before on each ring
    j = np.arange(a + b) - i
    third = np.where(along_outer, outer[(i + 1) % a], inner[(j + 1) % b])
    return np.stack([outer[i % a], third, inner[j % b]], axis=1)


def _at_rest(mesh: Mesh, first: int) -> Mesh:
    """The mesh with all vertices from `first` on where the squared Laplacian of place vanishes."""
    around = np.arange(len(mesh.vertices)) >= first
    for _ in range(2):
        near = mesh.faces[around[mesh.faces].any(axis=1)]
        around[near] = True
    place = np.cumsum(around) - 1
    size = int(around.sum())
    neighbours = adjacency(edges(Mesh(mesh.vertices[around], place[near])), size)
    degree = neighbours.sum(axis=1)
    laplacian = sparse.diags_array(degree) - neighbours
    rows = (laplacian @ sparse.diags_array(1 / degree) @ laplacian).tocsr()[place[first] :]
    free = size - (len(mesh.vertices) - first)
    vertices = mesh.vertices.copy()
    pull = rows[:, :free] @ mesh.vertices[around][:free]
    vertices[first:] = spsolve(rows[:, free:].tocsc(), -pull)
    return Mesh(vertices, mesh.faces)
