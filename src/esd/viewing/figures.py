"""Figures for print, drawn without a display."""

from __future__ import annotations

import os
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure

from esd.common import FloatArray, InputError, whole_file
from esd.matching.correspondence import Correspondence
from esd.mesh.mesh import Mesh, face_normals

_LIGHT = np.array([-0.4, 0.3, 0.85])
UNMATCHED = np.array([0.75, 0.75, 0.75])


def match_figure(source: Mesh, target: Mesh, match: Correspondence, *, up: str = "z") -> Figure:
    """Both shapes side by side; the target carries colours, the map brings them to the source.

    Where the map is right, a part has one colour on both. Source vertices without a match are
    grey.

    Parameters
    ----------
    up
        The axis, `y` or `z`, that points up in the meshes.

    Raises
    ------
    InputError
        If the axis is another.
    """
    if up not in ("y", "z"):
        raise InputError(f"`up` must be 'y' or 'z'; got '{up}'.")
    colours = position_colours(target)
    carried = np.where(
        match.is_matched()[:, None], colours[np.maximum(match.target_index, 0)], UNMATCHED
    )
    figure = Figure(figsize=(8, 6), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(1, 2)
    shown = ((source, carried, "source, by the map"), (target, colours, "target"))
    for axes, (mesh, colour, title) in zip(panels, shown, strict=True):
        draw_mesh(axes, mesh, colour, up)
        axes.set_title(title)
    return figure


def save_figure(figure: Figure, path: str | os.PathLike[str]) -> None:
    """Write a figure; the suffix, such as `.png` or `.pdf`, chooses the format."""
    with whole_file(path) as temporary:
        figure.savefig(temporary, dpi=150)


def position_colours(mesh: Mesh) -> FloatArray:
    """A colour of each vertex, (n, 3) between 0 and 1, that changes smoothly over space."""
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    relative = (mesh.vertices - low) / np.maximum(high - low, np.finfo(float).tiny)
    return np.asarray(0.1 + 0.85 * relative)


def draw_mesh(axes: Any, mesh: Mesh, colours: FloatArray, up: str) -> None:
    """Draw the faces that look at the viewer, the farthest first.

    Parameters
    ----------
    axes
        Of matplotlib.
    colours : (n, 3)
        Of the vertices, between 0 and 1.
    up
        The axis, `y` or `z`, that points up.
    """
    right, forward, vertical = (0, 1, 2) if up == "z" else (0, 2, 1)
    toward = -1 if up == "z" else 1
    normals = face_normals(mesh)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), np.finfo(float).tiny)
    view = np.stack([normals[:, right], normals[:, vertical], toward * normals[:, forward]], axis=1)
    depth = toward * mesh.vertices[mesh.faces, forward].mean(axis=1)
    order = np.argsort(depth)
    order = order[view[order, 2] > 0]
    shade = 0.45 + 0.55 * np.clip(view[order] @ (_LIGHT / np.linalg.norm(_LIGHT)), 0, 1)
    corners = mesh.vertices[mesh.faces[order]][:, :, [right, vertical]]
    paint = colours[mesh.faces[order]].mean(axis=1) * shade[:, None]
    faces = PolyCollection(
        corners, facecolors=paint, edgecolors=paint, linewidths=0.2, rasterized=True
    )
    axes.add_collection(faces)
    axes.set_aspect("equal")
    axes.autoscale_view()
    axes.set_axis_off()
