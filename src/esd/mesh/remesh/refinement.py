"""The surface with its edges halved until none is long."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from esd.common import BoolArray, FloatArray, IntArray
from esd.mesh.geometry import vertex_normals
from esd.mesh.mesh import Mesh
from esd.mesh.surface import faces_around
from esd.mesh.topology import edge_table


@dataclass(frozen=True, slots=True, eq=False)
class Refinement:
    """A refined surface of n vertices, m faces, e edges.

    Parameters
    ----------
    mesh : Mesh
    parent : (m,)
        Old face of which each face is a part.
    normals : (n, 3)
        Of the vertices.
    edges : (e, 2)
    rim : (b, 2)
        Edges with one face.
    around : (n, m)
        Which faces are at each vertex.
    """

    mesh: Mesh
    parent: IntArray
    normals: FloatArray
    edges: IntArray
    rim: IntArray
    around: sparse.csr_array


def refined(mesh: Mesh, longest: float) -> Refinement:
    """The surface with edges halved until none is longer; old vertices keep their numbers."""
    vertices, faces = mesh.vertices, mesh.faces
    parent = np.arange(len(faces))
    while True:
        table = edge_table(faces, len(vertices))
        long = np.linalg.norm(np.diff(vertices[table.ends], axis=1)[:, 0], axis=1) > longest
        if not long.any():
            break
        # the vertex in the middle of the side opposite to each corner, -1 where that stays whole
        middle = np.where(long, len(vertices) + np.cumsum(long) - 1, -1)[table.of_side]
        vertices = np.vstack([vertices, vertices[table.ends[long]].mean(axis=1)])
        faces, parent = _split(vertices, faces, middle, parent)
    fine = Mesh(vertices, faces)
    normals = vertex_normals(fine)
    rim = table.ends[table.count == 1]
    return Refinement(fine, parent, normals, table.ends, rim, faces_around(faces))


def _split(
    vertices: FloatArray, faces: IntArray, middle: IntArray, parent: IntArray
) -> tuple[IntArray, IntArray]:
    """Faces cut at the middles of their sides, (m, 3), -1 where a side stays whole."""
    count = (middle >= 0).sum(axis=1)
    pieces, parents = [faces[count == 0]], [parent[count == 0]]

    def add(chosen: BoolArray, *triangles: tuple[IntArray, IntArray, IntArray]) -> None:
        for triangle in triangles:
            pieces.append(np.stack(triangle, axis=1))
            parents.append(parent[chosen])

    chosen = count == 3
    (a, b, c), (bc, ca, ab) = faces[chosen].T, middle[chosen].T
    add(chosen, (a, ab, ca), (ab, b, bc), (ca, bc, c), (bc, ca, ab))
    for turn in range(3):
        corner, halved = np.roll(faces, -turn, axis=1), np.roll(middle, -turn, axis=1)
        chosen = (count == 1) & (halved[:, 0] >= 0)
        (a, b, c), bc = corner[chosen].T, halved[chosen, 0]
        add(chosen, (a, b, bc), (a, bc, c))
        chosen = (count == 2) & (halved[:, 0] < 0)
        (a, b, c), (_, ca, ab) = corner[chosen].T, halved[chosen].T
        # the quadrangle ab-b-c-ca, cut along its shorter diagonal
        across = np.linalg.norm(vertices[ab] - vertices[c], axis=1)
        shorter = across < np.linalg.norm(vertices[b] - vertices[ca], axis=1)
        add(
            chosen,
            (a, ab, ca),
            (ab, b, np.where(shorter, c, ca)),
            (np.where(shorter, ab, b), c, ca),
        )
    return np.concatenate(pieces), np.concatenate(parents)
