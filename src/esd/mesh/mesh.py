"""The triangle mesh, and what can be read off it directly."""

from __future__ import annotations

import os
from collections.abc import Mapping
from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt
from scipy import sparse
from scipy.sparse import csgraph

from esd.common import FloatArray, InputError, IntArray

MeshLike: TypeAlias = Any
"""A `Mesh`, a path, a pair (vertices, faces), or a trimesh, meshio or pyvista mesh."""


@dataclass(frozen=True, slots=True, eq=False)
class Mesh:
    """A triangle mesh in three dimensions.

    Both arrays are copied, converted and made read-only.

    Parameters
    ----------
    vertices : (n, 3) float64
        Positions, in any unit of length. All finite.
    faces : (m, 3) int64
        Vertex indices from 0, counter-clockwise seen from outside. m is at least one.

    Raises
    ------
    InputError
        If a shape, a type, a coordinate or an index is not as described.
    """

    vertices: npt.NDArray[np.float64]
    faces: IntArray

    def __post_init__(self) -> None:
        object.__setattr__(self, "vertices", _checked_vertices(self.vertices))
        object.__setattr__(self, "faces", _checked_faces(self.faces, len(self.vertices)))


@dataclass(frozen=True, slots=True, eq=False)
class PointCloud:
    """Points of a surface whose triangles are not known.

    Parameters
    ----------
    vertices : (n, 3) float64
        Positions, in any unit of length. All finite. Copied and made read-only.

    Raises
    ------
    InputError
        If the shape, the type or a coordinate is not as described.
    """

    vertices: npt.NDArray[np.float64]

    def __post_init__(self) -> None:
        object.__setattr__(self, "vertices", _checked_vertices(self.vertices))


def _checked_vertices(vertices: npt.ArrayLike) -> npt.NDArray[np.float64]:
    try:
        array = np.array(vertices, dtype=np.float64, order="C")
    except (TypeError, ValueError) as error:
        raise InputError(f"`vertices` must be numbers of shape (n, 3): {error}") from error
    if array.ndim != 2 or array.shape[1] != 3:
        hint = " Transpose it?" if array.ndim == 2 and array.shape[0] == 3 else ""
        raise InputError(f"`vertices` must have shape (n, 3); got {array.shape}.{hint}")
    bad = np.flatnonzero(~np.isfinite(array).all(axis=1))
    if len(bad):
        raise InputError(
            f"`vertices` must be finite; {len(bad)} are not, the first is vertex {bad[0]}: "
            f"{array[bad[0]].tolist()}."
        )
    array.flags.writeable = False
    return array


def _checked_faces(faces: npt.ArrayLike, vertex_count: int) -> IntArray:
    array = np.asarray(faces)
    if array.ndim != 2 or array.shape[1] != 3:
        hint = " Transpose it?" if array.ndim == 2 and array.shape[0] == 3 else ""
        raise InputError(f"`faces` must have shape (m, 3); got {array.shape}.{hint}")
    if len(array) == 0:
        raise InputError("The mesh has no faces; a surface is needed, not a point cloud.")
    if array.dtype.kind not in "iu":
        raise InputError(f"`faces` must be integers; got {array.dtype}.")
    array = np.array(array, dtype=np.int64, order="C")
    bad = np.flatnonzero(((array < 0) | (array >= vertex_count)).any(axis=1))
    if len(bad):
        raise InputError(
            f"`faces` must hold indices from 0 to {vertex_count - 1}; {len(bad)} do not, "
            f"the first is face {bad[0]}: {array[bad[0]].tolist()}."
        )
    array.flags.writeable = False
    return array


def as_mesh(source: MeshLike) -> Mesh:
    """The `Mesh` of whatever holds one.

    Parameters
    ----------
    source
        A `Mesh`; the path of a mesh file; a pair (vertices, faces); or an object of trimesh
        (`vertices`, `faces`), meshio (`points`, `cells_dict`) or pyvista (`points`, `regular_faces`
        or `faces`). Vertex order and count are kept. None of these packages is imported.

    Raises
    ------
    InputError
        If there is no triangle mesh in `source`.
    """
    if isinstance(source, Mesh):
        return source
    if isinstance(source, (str, os.PathLike)):
        from esd.mesh.files import read_mesh  # reading a mesh makes one: imported when called

        return read_mesh(Path(source))
    return Mesh(*as_arrays(source))


def as_arrays(source: MeshLike) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
    """Vertices (n, 3) and faces (m, 3) of whatever `as_mesh` takes, as they are: not yet checked.

    A `PointCloud`, and a file without faces, have faces of shape (0, 3).

    Raises
    ------
    InputError
        If there are no vertices and faces in `source`.
    """
    if isinstance(source, Mesh):
        return source.vertices, source.faces
    if isinstance(source, PointCloud):
        return source.vertices, np.zeros((0, 3), dtype=np.int64)
    if isinstance(source, (str, os.PathLike)):
        from esd.mesh.files import read_arrays  # reads by way of this module

        return read_arrays(Path(source))
    if isinstance(source, tuple | list) and len(source) == 2:
        return source[0], source[1]
    if hasattr(source, "vertices") and hasattr(source, "faces"):
        return np.asarray(source.vertices), np.asarray(source.faces)
    if hasattr(source, "points") and hasattr(source, "cells_dict"):
        cells = source.cells_dict
        if "triangle" not in cells:
            raise InputError(
                f"The meshio mesh has no triangles, only {sorted(cells) or 'points'}; "
                "triangulate it first."
            )
        return np.asarray(source.points), np.asarray(cells["triangle"])
    if hasattr(source, "points") and hasattr(source, "faces"):
        return np.asarray(source.points), _pyvista_triangles(np.asarray(source.faces))
    raise InputError(
        "Expected a mesh: a path, (vertices, faces), or a trimesh, meshio or pyvista mesh; "
        f"got {type(source).__name__}."
    )


def with_attributes(source: MeshLike, attributes: Mapping[str, npt.NDArray[Any]]) -> Any:
    """A copy of a trimesh, meshio or pyvista mesh with attributes of its vertices.

    They are in `vertex_attributes` of trimesh, `point_data` of meshio and pyvista.

    Parameters
    ----------
    attributes
        Such as `Correspondence.attributes()`: arrays (n, ...).

    Raises
    ------
    InputError
        If `source` is none of these, or an attribute has another length.
    """
    for place in ("point_data", "vertex_attributes"):
        if hasattr(source, place):
            break
    else:
        raise InputError(
            f"Expected a trimesh, meshio or pyvista mesh; got {type(source).__name__}."
        )
    count = len(as_mesh(source).vertices)
    for name, values in attributes.items():
        if len(values) != count:
            raise InputError(
                f"The attribute '{name}' must have a value for each of {count} vertices; "
                f"got {len(values)}."
            )
    result = deepcopy(source)
    getattr(result, place).update(attributes)
    return result


def _pyvista_triangles(padded: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Faces of pyvista's flat list, in which the vertex count stands before each face."""
    if padded.ndim == 2:
        return padded
    if len(padded) % 4 or (padded[::4] != 3).any():
        raise InputError("The pyvista mesh has more than triangles; call its triangulate().")
    return padded.reshape(-1, 4)[:, 1:]


def face_normals(mesh: Mesh) -> FloatArray:
    """Normals of the faces, (m, 3), each as long as twice its face's area."""
    a, b, c = (mesh.vertices[mesh.faces[:, i]] for i in range(3))
    return np.asarray(np.cross(b - a, c - a))


def face_areas(mesh: Mesh) -> FloatArray:
    """Areas of the faces, (m,), in squared units of length."""
    return np.asarray(np.linalg.norm(face_normals(mesh), axis=1) / 2)


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
    for corner in range(3):
        np.add.at(normals, mesh.faces[:, corner], of_faces)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.divide(normals, length, out=normals, where=length > 0)


def edge_lengths(mesh: Mesh) -> FloatArray:
    """Lengths of the three sides of each face, (m, 3); side i lies opposite to corner i."""
    corners = mesh.vertices[mesh.faces]
    return np.asarray(np.linalg.norm(corners[:, [2, 0, 1]] - corners[:, [1, 2, 0]], axis=2))


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
    rank = np.empty(len(found), dtype=np.int64)
    rank[np.argsort(-count, kind="stable")] = np.arange(len(found))
    result = np.full(size, -1, dtype=np.int64)
    result[referenced] = rank[inverse]
    return result


def signed_volume(mesh: Mesh) -> float:
    """Signed volume inside a closed surface, in cubed units; positive if normals point outward.

    For an open surface it is the volume of the cone over it seen from the mean of the vertices.
    """
    a, b, c = ((mesh.vertices - mesh.vertices.mean(axis=0))[mesh.faces[:, i]] for i in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)


def boundary_edges(mesh: Mesh) -> IntArray:
    """Directed edges that only one face has, (b, 2)."""
    sides = mesh.faces[:, [[1, 2], [2, 0], [0, 1]]].reshape(-1, 2)
    _, index, count = np.unique(
        np.sort(sides, axis=1), axis=0, return_index=True, return_counts=True
    )
    return np.asarray(sides[index[count == 1]])


def is_consistently_oriented(mesh: Mesh) -> bool:
    """Whether neighbouring faces wind the same way: no directed edge occurs twice."""
    start, end = mesh.faces[:, [1, 2, 0]].ravel(), mesh.faces[:, [2, 0, 1]].ravel()
    key = np.sort(start * len(mesh.vertices) + end)
    return not (key[1:] == key[:-1]).any()
