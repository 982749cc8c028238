"""Which axis of a shape points up, where nothing says it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from esd.common import FloatArray
from esd.mesh.geometry import is_referenced, vertex_areas
from esd.mesh.mesh import Mesh

AXES = ("x", "-x", "y", "-y", "z", "-z")
"""Axes that may point up."""

_LIKELY = ("y", "-y", "z", "-z")  # as programs write them: x is to the side
_SOLE = 0.04  # of the longest extent: what is not higher than this stands on the ground
_NO_FEET = 0.005  # added to the share of the ground, so that none is impossible
_USUAL = 1.5  # times as likely is what is usual,
_TALL = 3.0  # and so many times where it is the longest axis


def default_up(mesh: Mesh, *, usual: str | None = None) -> str:
    """The axis that probably points up: y, -y, z or -z.

    That by which the shape stands on a wide ground (the share of the convex hull of what touches it
    in the bounding box, seen from above), most of its area is high up, and it is tall. What is
    usual is preferred to what is little better.

    Parameters
    ----------
    usual
        See `usual_up`; by default z where the mesh is longest along z, y otherwise.
    """
    used = is_referenced(mesh)
    vertices, areas = mesh.vertices[used], vertex_areas(mesh)[used]
    longest = "xyz"[np.ptp(mesh.vertices, axis=0).argmax()]
    usual = usual or ("z" if longest == "z" else "y")
    if not areas.sum() > 0:
        return usual
    rated = {axis: _rating(vertices, areas, axis) for axis in (usual, *_LIKELY)}
    rated[usual] *= _TALL if longest == usual else _USUAL
    return max(rated, key=lambda axis: rated[axis])


def usual_up(path: Path) -> str | None:
    """The axis that points up by the specification of a file's format; None where there is none."""
    return "y" if path.suffix.lower() in (".glb", ".gltf") else None


def _rating(vertices: FloatArray, areas: FloatArray, axis: str) -> float:
    """How well a shape stands with an axis upward."""
    along = "xyz".index(axis[-1])
    extent = np.ptp(vertices, axis=0)
    height = vertices[:, along] * (-1 if axis[0] == "-" else 1)
    height = height - height.min()
    if extent.min() <= 0:
        return 0.0
    middle = float(np.average(height, weights=areas)) / extent[along]
    ground = np.delete(vertices[height < _SOLE * extent.max()], along, axis=1)
    feet = _hull_area(ground) * extent[along] / extent.prod()
    high = (middle / max(1 - middle, 1e-6)) ** 2
    return float((feet + _NO_FEET) * high * extent[along] / extent.max())


def _hull_area(points: FloatArray) -> float:
    """The area of the convex hull of points of a plane, (p, 2)."""
    if len(points) < 3:
        return 0.0
    try:
        return float(ConvexHull(points).volume)  # of a plane figure, its area
    except QhullError:  # they lie on a line
        return 0.0
