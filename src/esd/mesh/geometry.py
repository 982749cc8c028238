"""Areas, normals and edges of meshes."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy import sparse
from scipy.sparse import csgraph

from esd.common import FloatArray, IntArray
from esd.mesh.mesh import Mesh


def unit(vectors: FloatArray) -> FloatArray:
    """Vectors (n, d) of length one in the same directions; null vectors stay."""
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.asarray(vectors / np.maximum(length, np.finfo(float).tiny))


def face_normals(mesh: Mesh) -> FloatArray:
    """Normals of the faces, (m, 3), each as long as twice its face's area."""
    # `np.take` and products of columns: of millions of faces indexing and `np.cross` take twice
    # the time
    a, b, c = (np.take(mesh.vertices, mesh.faces[:, i], axis=0) for i in range(3))
    b -= a
    c -= a
    normals = np.empty((len(mesh.faces), 3))
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        normals[:, i] = b[:, j] * c[:, k] - b[:, k] * c[:, j]
    return normals


def face_areas(mesh: Mesh) -> FloatArray:
    """Areas of the faces, (m,), in squared units of length."""
    normals = face_normals(mesh)
    return np.asarray(np.sqrt(np.einsum("ij,ij->i", normals, normals)) / 2)


def surface_area(mesh: Mesh) -> float:
    """Area of the whole surface, in squared units of length."""
    return float(face_areas(mesh).sum())


def vertex_areas(mesh: Mesh) -> FloatArray:
    """A third of the area of the faces at each vertex, (n,); their sum is the surface area."""
    shares = np.repeat(face_areas(mesh) / 3, 3)
    return np.asarray(
        np.bincount(mesh.faces.ravel(), weights=shares, minlength=len(mesh.vertices)), dtype=float
    )


def vertex_normals(mesh: Mesh) -> FloatArray:
    """Unit normals of the vertices, (n, 3): means of the faces' normals, weighted by area.

    Zero where a vertex has no face or its normals cancel.
    """
    normals, of_faces = np.zeros_like(mesh.vertices), face_normals(mesh)
    for corner in mesh.faces.T:
        for axis in range(3):
            normals[:, axis] += np.bincount(corner, of_faces[:, axis], len(normals))
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.divide(normals, length, out=normals, where=length > 0)


def edge_lengths(mesh: Mesh) -> FloatArray:
    """Lengths of the three sides of each face, (m, 3); side i lies opposite to corner i."""
    corners = np.take(mesh.vertices, mesh.faces, axis=0)
    sides = corners[:, [2, 0, 1]] - corners[:, [1, 2, 0]]
    return np.asarray(np.sqrt(np.einsum("msi,msi->ms", sides, sides)))


def edges(mesh: Mesh) -> IntArray:
    """Undirected edges, (e, 2), each once with the smaller index first, sorted."""
    start, end = mesh.faces[:, [1, 2, 0]].ravel(), mesh.faces[:, [2, 0, 1]].ravel()
    # one number an edge: np.unique of pairs, or without sorting, takes ten times as long
    key = np.sort(np.minimum(start, end) * len(mesh.vertices) + np.maximum(start, end))
    first = np.append(True, key[1:] != key[:-1])[: len(key)]
    return np.stack(np.divmod(key[first], len(mesh.vertices)), axis=1)


def adjacency(pairs: IntArray, size: int) -> sparse.csr_array:
    """The matrix (size, size) of ones between the ends of undirected edges (e, 2), each once."""
    half = sparse.coo_array((np.ones(len(pairs)), tuple(pairs.T)), shape=(size, size)).tocsr()
    return half + half.T


def is_referenced(mesh: Mesh) -> npt.NDArray[np.bool_]:
    """Whether each vertex belongs to a face, (n,)."""
    referenced = np.zeros(len(mesh.vertices), dtype=bool)
    referenced[mesh.faces] = True
    return referenced


def components(mesh: Mesh) -> IntArray:
    """Number of the connected component of each vertex, (n,), the one with most vertices first.

    Vertices without a face have -1.
    """
    pairs = edges(mesh)
    size = len(mesh.vertices)
    graph = sparse.coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(size, size))
    _, label = csgraph.connected_components(graph, directed=False)
    referenced = is_referenced(mesh)
    found, inverse, count = np.unique(label[referenced], return_inverse=True, return_counts=True)
    # rank[i]: the place of the i-th label found when they are sorted by size
    rank = np.empty(len(found), dtype=np.int64)
    rank[np.argsort(-count, kind="stable")] = np.arange(len(found))
    result = np.full(size, -1, dtype=np.int64)
    result[referenced] = rank[inverse]
    return result


def is_consistently_oriented(mesh: Mesh) -> bool:
    """Whether neighbouring faces are consistently oriented: no directed edge occurs twice."""
    start, end = mesh.faces[:, [1, 2, 0]].ravel(), mesh.faces[:, [2, 0, 1]].ravel()
    key = np.sort(start * len(mesh.vertices) + end)
    return not (key[1:] == key[:-1]).any()
