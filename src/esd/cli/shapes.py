"""Shapes as commands read them that need no repaired ones."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from esd.cli.output import about

if TYPE_CHECKING:
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
    from esd.common import InputError
    from esd.mesh.geometry import surface_area
    from esd.mesh.repair.repair import usable_part

    with about(path):
        mesh = usable_part(path)
        if not surface_area(mesh) > 0:
            raise InputError("Its faces have no area; a surface is needed.")
        return mesh
