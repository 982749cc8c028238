"""Shapes and landmarks as commands read them that need no repaired shapes."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import typer

from esd.cli.output import about

if TYPE_CHECKING:
    from esd.common import IntArray
    from esd.matching.correspondence import Correspondence
    from esd.mesh.convert import MeshLike
    from esd.mesh.mesh import Mesh, PointCloud


def read_shape(path: Path) -> Mesh | PointCloud:
    """The shape in a file with all its vertices, and those of its faces that can be drawn."""
    from esd.mesh.convert import as_arrays
    from esd.mesh.mesh import PointCloud
    from esd.mesh.repair.repair import usable_part

    with about(path):
        vertices, faces = as_arrays(path)
        return usable_part((vertices, faces)) if len(faces) else PointCloud(vertices)


def read_drawable(path: Path) -> Mesh:
    """The mesh in a file with all its vertices, and those of its faces that can be drawn.

    Raises
    ------
    InputError
        If there are none, or they have no area.
    """
    from esd.mesh.repair.repair import usable_part

    with about(path):
        return _with_area(usable_part(path))


def read_shown(path: Path) -> Mesh:
    """What is shown of a file: its drawable mesh, or triangles between points without faces.

    Raises
    ------
    InputError
        If there is nothing that can be drawn.
    """
    from esd.mesh.cloud import surface_between
    from esd.mesh.mesh import PointCloud

    with about(path):
        shape = read_shape(path)
        return surface_between(shape) if isinstance(shape, PointCloud) else _with_area(shape)


def _with_area(mesh: Mesh) -> Mesh:
    """The mesh, if it can be drawn."""
    from esd.common import InputError
    from esd.mesh.geometry import surface_area

    if not surface_area(mesh) > 0:
        raise InputError("Its faces have no area; a surface is needed.")
    return mesh


def read_map(path: Path, *, source_count: int, target_count: int) -> Correspondence:
    """The map in a file, for meshes of some numbers of vertices.

    Raises
    ------
    InputError
        If it is damaged, fits other meshes, or has no match.
    """
    from esd.common import InputError
    from esd.matching.correspondence import load_map

    found = load_map(path, source_count=source_count, target_count=target_count)
    if not found.is_matched().any():
        raise InputError(f"'{path}' has no match: all its vertices are without one.")
    return found


def landmark_pairs(
    files: list[Path], source: MeshLike, target: MeshLike
) -> tuple[tuple[str, ...], IntArray | None]:
    """Names of landmarks, and pairs (l, 2) of vertices; none if there is no file."""
    if not files:
        return (), None
    if len(files) > 2:
        raise typer.BadParameter("--landmarks takes one file or two.")
    from esd.matching.landmarks import paired_landmarks, read_landmark_pairs

    if len(files) == 1:
        return read_landmark_pairs(files[0])
    from esd.mesh.io.landmarks import read_landmarks
    from esd.mesh.repair.repair import usable_part

    read = [
        read_landmarks(file, usable_part(mesh))
        for file, mesh in zip(files, (source, target), strict=True)
    ]
    return paired_landmarks(*read)
