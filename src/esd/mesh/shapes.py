"""Shapes whose spectra and distances are known in closed form, for tests and examples."""

from __future__ import annotations

import numpy as np

from esd.common import FloatArray, IntArray
from esd.mesh.mesh import Mesh
from esd.mesh.topology import edge_table


def icosphere(subdivisions: int, *, radius: float = 1.0) -> Mesh:
    """A sphere of 10 · 4^s + 2 vertices: an icosahedron subdivided s times.

    Its Laplace-Beltrami eigenvalues are l (l + 1) / radius², each 2 l + 1 times.
    """
    golden = (1 + 5**0.5) / 2
    rectangle = np.array([(s, t * golden, 0.0) for s in (-1, 1) for t in (-1, 1)])
    corners = np.concatenate([np.roll(rectangle, shift, axis=1) for shift in range(3)])
    mesh = Mesh(corners, _hull_faces(corners))
    for _ in range(subdivisions):
        mesh = subdivide(mesh)
    unit = mesh.vertices / np.linalg.norm(mesh.vertices, axis=1, keepdims=True)
    return Mesh(radius * unit, mesh.faces)


def _hull_faces(vertices: FloatArray) -> IntArray:
    """Triangles of an icosahedron's corners: all triples at mutual distance 2, facing outward."""
    near = np.isclose(np.linalg.norm(vertices[:, None] - vertices[None], axis=2), 2.0)
    i, j, k = np.nonzero(near[:, :, None] & near[:, None, :] & near[None, :, :])
    triples = np.stack([i, j, k], axis=1)[(i < j) & (j < k)]
    inward = np.linalg.det(vertices[triples]) < 0
    triples[inward] = triples[inward][:, ::-1]
    return triples.astype(np.int64)


def subdivide(mesh: Mesh) -> Mesh:
    """The mesh with each face cut in four at the midpoints of its edges.

    The first vertices are those of `mesh`, in their order; one for each edge follows.
    """
    table = edge_table(mesh.faces, len(mesh.vertices))
    x, y, z = (table.of_side + len(mesh.vertices)).T  # the midpoints opposite to a, b, c
    a, b, c = mesh.faces.T
    quarters = [(a, z, y), (z, b, x), (y, x, c), (x, y, z)]
    faces = np.concatenate([np.stack(quarter, axis=1) for quarter in quarters])
    return Mesh(np.concatenate([mesh.vertices, mesh.vertices[table.ends].mean(axis=1)]), faces)


def torus(around: int, across: int, *, radius: float = 1.0, tube: float = 0.4) -> Mesh:
    """A torus of around × across vertices: radius to the middle of the tube, and the tube's."""
    u, v = np.meshgrid(
        2 * np.pi * np.arange(around) / around,
        2 * np.pi * np.arange(across) / across,
        indexing="ij",
    )
    reach = radius + tube * np.cos(v)
    x, y, z = np.broadcast_arrays(reach * np.cos(u), reach * np.sin(u), tube * np.sin(v))
    vertices = np.stack([x, y, z], axis=2)
    # vertex index[i, j] is the j-th across the tube at the i-th around; both ways are closed
    index = np.arange(around * across).reshape(around, across)
    right, up = np.roll(index, -1, axis=0), np.roll(index, -1, axis=1)
    return Mesh(vertices.reshape(-1, 3), _split_quads(index, right, np.roll(right, -1, axis=1), up))


def grid(columns: int, rows: int, *, width: float = 1.0, height: float = 1.0) -> Mesh:
    """A flat rectangle of columns × rows vertices, its normals along +z.

    Its eigenvalues, with free boundary, are π² (p² / width² + q² / height²) for p, q ≥ 0.
    """
    sides = np.linspace(0, width, columns), np.linspace(0, height, rows)
    x, y = np.meshgrid(*sides, indexing="ij")
    vertices = np.stack([x, y, np.zeros_like(x)], axis=2).reshape(-1, 3)
    index = np.arange(columns * rows).reshape(columns, rows)
    faces = _split_quads(index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:])
    return Mesh(vertices, faces)


def _split_quads(a: IntArray, b: IntArray, c: IntArray, d: IntArray) -> IntArray:
    corners = [np.stack([a, b, c], axis=-1), np.stack([a, c, d], axis=-1)]
    return np.concatenate([corner.reshape(-1, 3) for corner in corners])
