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
from esd.mesh.io.meshes import read_arrays, read_mesh
from esd.mesh.mesh import Mesh, PointCloud
from esd.mesh.objects import object_arrays

MeshLike: TypeAlias = Any
"""A `Mesh`, a path, a pair (vertices, faces), or a trimesh, meshio, pyvista or Open3D mesh."""


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
        return read_arrays(Path(source))
    return object_arrays(source)


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
