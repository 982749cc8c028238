"""Arrays of other packages' meshes and point clouds, none of which is imported."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from esd.common import InputError

_VTK_TRIANGLE, _VTK_QUAD = 5, 9


def object_arrays(source: Any) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
    """Vertices (n, 3) and faces (m, 3) of a pair of arrays or another package's object.

    They are not checked. What has no faces has faces of shape (0, 3).

    Raises
    ------
    InputError
        If there are no vertices and faces in `source`.
    """
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
