"""Meshes from paths, arrays and other packages' objects, and back."""

from __future__ import annotations

import os
from collections.abc import Mapping
from copy import deepcopy
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from esd.common import InputError
from esd.mesh.mesh import Mesh, PointCloud

MeshLike: TypeAlias = Any
"""A `Mesh`, a path, a pair (vertices, faces), or a trimesh, meshio, pyvista or Open3D mesh."""

_VTK_TRIANGLE, _VTK_QUAD = 5, 9


def as_mesh(source: MeshLike) -> Mesh:
    """The `Mesh` of whatever holds one.

    Parameters
    ----------
    source
        A `Mesh`; the path of a mesh file; a pair (vertices, faces); or an object of trimesh
        (`vertices`, `faces`; or a scene, its parts placed and joined), Open3D (`vertices`,
        `triangles`), meshio (`points`, `cells_dict`) or pyvista (`points`, `faces`; or
        `cells_dict` of an unstructured grid). Vertex order and count are kept. None of these
        packages is imported.

    Raises
    ------
    InputError
        If there is no triangle mesh in `source`.
    """
    if isinstance(source, Mesh):
        return source
    if isinstance(source, (str, os.PathLike)):
        from esd.mesh.io.meshes import read_mesh  # reading a mesh makes one: imported when called

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
        from esd.mesh.io.meshes import read_arrays  # reads by way of this module

        return read_arrays(Path(source))
    if isinstance(source, tuple | list) and len(source) == 2:
        return source[0], source[1]
    if hasattr(source, "geometry") and hasattr(source, "to_mesh"):  # a scene of trimesh
        if not any(hasattr(each, "faces") for each in source.geometry.values()):
            raise InputError("The trimesh scene has no meshes.")
        source = source.to_mesh()
    if hasattr(source, "vertices"):
        for name in ("faces", "triangles"):  # trimesh, Open3D
            if hasattr(source, name):
                return np.asarray(source.vertices), np.asarray(getattr(source, name))
        return np.asarray(source.vertices), np.zeros((0, 3), dtype=np.int64)  # a cloud of trimesh
    if hasattr(source, "points") and hasattr(source, "cells_dict"):
        return _cells(np.asarray(source.points), source.cells_dict)
    if hasattr(source, "points") and hasattr(source, "faces"):
        return np.asarray(source.points), _pyvista_triangles(np.asarray(source.faces))
    if hasattr(source, "points") and type(source).__module__.startswith("open3d"):
        return np.asarray(source.points), np.zeros((0, 3), dtype=np.int64)
    raise InputError(
        "Expected a mesh: a path, (vertices, faces), or a trimesh, meshio, pyvista or Open3D mesh; "
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


def _cells(
    points: npt.NDArray[Any], cells: Mapping[Any, Any]
) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
    """Triangles and quadrilaterals, cut in two, of cells by their type.

    meshio names the types, pyvista has VTK's numbers.
    """
    parts = []
    for kind, corners in cells.items():
        if kind in ("triangle", _VTK_TRIANGLE):
            parts.append(np.asarray(corners))
        elif kind in ("quad", _VTK_QUAD):
            quads = np.asarray(corners).reshape(-1, 4)
            halves = np.stack([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]], axis=1)
            parts.append(halves.reshape(-1, 3))
    if not parts:
        found = ", ".join(sorted(map(str, cells))) or "points"
        raise InputError(
            f"The mesh has no triangles, only cells of type {found}; extract its surface and "
            "triangulate it first."
        )
    return points, np.concatenate(parts)


def _pyvista_triangles(padded: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Faces of pyvista's flat list, in which the vertex count precedes each face."""
    if padded.ndim == 2:
        return padded
    if len(padded) % 4 or (padded[::4] != 3).any():
        raise InputError("The pyvista mesh has more than triangles; call its triangulate().")
    return padded.reshape(-1, 4)[:, 1:]
