"""Figures for print, drawn without a display."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.collections import PolyCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from esd.common import FloatArray, InputError, check_can_be_made, whole_file
from esd.evaluation.errors import area_under_curve, cumulative_curve
from esd.evaluation.protocol import PairErrors
from esd.matching.correspondence import Correspondence
from esd.mesh.geometry import face_normals, vertex_normals
from esd.mesh.mesh import Mesh
from esd.viewing.colours import UNMATCHED, carried_colours, position_colours

_LIGHT = np.array([-0.4, 0.3, 0.85])
_DASHES = ("-", "--", "-.", ":")
# colours that people with colour blindness tell apart: Okabe and Ito 2008, without the yellow
_OKABE_ITO = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")


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
    _check_up(up)
    colours = position_colours(target)
    carried = carried_colours(colours, match.target_index)
    figure, panels = _panels(2)
    shown = ((source, carried, "source, by the map"), (target, colours, "target"))
    for axes, (mesh, colour, title) in zip(panels, shown, strict=True):
        draw_mesh(axes, mesh, colour, up)
        axes.set_title(title)
    return figure


def values_figure(
    mesh: Mesh,
    values: Mapping[str, FloatArray],
    *,
    up: str = "z",
    largest: float | None = None,
    colour_map: str = "viridis",
    label: str = "",
) -> Figure:
    """A shape once for each array of values at its vertices, such as errors or descriptors.

    Each has its own scale, unless `largest` is given. Vertices without a value are grey.

    Parameters
    ----------
    values
        Arrays (n,) by their titles.
    largest
        End of the scale of all, which then begins at zero.
    colour_map
        Name of a map of matplotlib; the default's lightness rises evenly, so that it survives
        colour blindness and grey print.
    label
        Of the scale.

    Raises
    ------
    InputError
        If values do not fit the mesh, there are none, or the axis is neither `y` nor `z`.
    """
    _check_up(up)
    if not values:
        raise InputError("There are no values to draw.")
    for title, array in values.items():
        if array.shape != (len(mesh.vertices),):
            raise InputError(
                f"The values '{title}' must have shape ({len(mesh.vertices)},); got {array.shape}."
            )
    figure, panels = _panels(len(values))
    for axes, (title, array) in zip(panels, values.items(), strict=True):
        known = np.isfinite(array)
        scale = Normalize(0, largest) if largest else Normalize(*_range(array[known]))
        mappable = ScalarMappable(scale, colour_map)
        colours = mappable.to_rgba(np.where(known, array, 0))[:, :3]
        draw_mesh(axes, mesh, np.where(known[:, None], colours, UNMATCHED), up)
        axes.set_title(title)
        figure.colorbar(mappable, ax=axes, shrink=0.6, label=label)
    return figure


def curves_figure(
    errors: Mapping[str, FloatArray], *, largest: float = 0.25, label: str = "error / √area"
) -> Figure:
    """Share of points with at most an error, over the error: the curves of the field.

    Parameters
    ----------
    errors
        Arrays by the name of the method; NaN counts as larger than any.
    largest
        Right end of the axis, in the errors' unit.
    label
        Of that axis.

    Raises
    ------
    InputError
        If there are no errors.
    """
    if not errors:
        raise InputError("There are no errors to draw.")
    figure = blank_figure(6, 4)
    axes = figure.subplots()
    radii = np.linspace(0, largest, 201)
    draw_curves(
        axes, radii, {name: cumulative_curve(array, radii) for name, array in errors.items()}
    )
    axes.set_xlabel(label)
    return figure


def errors_figure(errors: Mapping[str, Sequence[PairErrors]]) -> Figure:
    """The curves of the Princeton protocol, means over pairs, with both usual normalisers.

    Left over √area up to 0.25, right over the geodesic diameter up to 0.2. The legends name the
    area under each curve as a share of its panel, left the `auc` of `Evaluation`.

    Parameters
    ----------
    errors
        Of `esd.evaluation.protocol.evaluate`, by the names of the models.

    Raises
    ------
    InputError
        If there are no errors.
    """
    if not errors:
        raise InputError("There are no errors to draw.")
    figure = blank_figure(11, 4)
    for axes, (title, largest, unit) in zip(figure.subplots(1, 2), _NORMALISERS, strict=True):
        radii = np.linspace(0, largest, 201)
        curves = {}
        for name, pairs in errors.items():
            scaled = [pair.errors / unit(pair) for pair in pairs]
            area = np.mean([area_under_curve(error, largest=largest) for error in scaled])
            mean = np.mean([cumulative_curve(error, radii) for error in scaled], axis=0)
            curves[f"{name} (AUC {area:.3f})"] = mean
        draw_curves(axes, radii, curves)
        axes.set_xlabel(title)
    return figure


_NORMALISERS: tuple[tuple[str, float, Callable[[PairErrors], float]], ...] = (
    ("geodesic error / √area", 0.25, lambda pair: pair.square_root_area),
    ("geodesic error / geodesic diameter", 0.2, lambda pair: pair.diameter),
)


def draw_curves(axes: Any, radii: FloatArray, shares: Mapping[str, FloatArray]) -> None:
    """Draw shares of points, (r,) each by name, over the radii within which they lie, (r,)."""
    for i, (name, share) in enumerate(shares.items()):
        style: dict[str, Any] = {
            "color": _OKABE_ITO[i % len(_OKABE_ITO)],
            "linestyle": _DASHES[i % len(_DASHES)],
        }
        axes.plot(radii, 100 * share, label=name, **style)
    axes.set(xlim=(0, radii[-1]), ylim=(0, 100), ylabel="points (%)")
    axes.grid(alpha=0.3)
    axes.legend(loc="lower right")


def check_figure_path(path: str | os.PathLike[str]) -> Path:
    """The path, if a figure can be written to it; raises an `InputError` otherwise."""
    path = Path(path)
    if path.suffix.lower() not in (".png", ".pdf", ".svg"):
        raise InputError(f"'{path}': figures are written as .png, .pdf or .svg files.")
    return check_can_be_made(path)


def save_figure(figure: Figure, path: str | os.PathLike[str]) -> None:
    """Write a figure; the suffix, such as `.png` or `.pdf`, chooses the format."""
    with whole_file(path) as temporary:
        figure.savefig(temporary, dpi=150)


def blank_figure(width: float, height: float) -> Figure:
    """A figure of a size in inches, drawn without a display."""
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def axis_up(meshes: Iterable[Mesh]) -> str:
    """The axis, `y` or `z`, along which most of some meshes are longer."""
    extents = np.array([np.ptp(mesh.vertices, axis=0) for mesh in meshes])
    return "y" if np.median(extents[:, 1]) > np.median(extents[:, 2]) else "z"


def _check_up(up: str) -> None:
    if up not in ("y", "z"):
        raise InputError(f"`up` must be 'y' or 'z'; got '{up}'.")


def _panels(count: int) -> tuple[Figure, Sequence[Any]]:
    """A figure without a display, and its panels side by side."""
    figure = blank_figure(4 * count, 6)
    return figure, figure.subplots(1, count, squeeze=False)[0]


def _range(values: FloatArray) -> tuple[float, float]:
    return (float(values.min()), float(values.max())) if len(values) else (0.0, 1.0)


def draw_mesh(axes: Any, mesh: Mesh, colours: FloatArray, up: str) -> None:
    """Draw the faces that look at the viewer, the farthest first, shaded as a smooth surface."""
    right, forward, vertical = (0, 1, 2) if up == "z" else (0, 2, 1)
    toward = -1 if up == "z" else 1
    depth = toward * mesh.vertices[mesh.faces, forward].mean(axis=1)
    order = np.argsort(depth)
    order = order[toward * face_normals(mesh)[order, forward] > 0]
    normals = vertex_normals(mesh)[mesh.faces[order]].mean(axis=1)
    view = np.stack([normals[:, right], normals[:, vertical], toward * normals[:, forward]], axis=1)
    shade = 0.45 + 0.55 * np.clip(view @ (_LIGHT / np.linalg.norm(_LIGHT)), 0, 1)
    corners = mesh.vertices[mesh.faces[order]][:, :, [right, vertical]]
    paint = colours[mesh.faces[order]].mean(axis=1) * shade[:, None]
    faces = PolyCollection(
        corners, facecolors=paint, edgecolors=paint, linewidths=0.2, rasterized=True
    )
    axes.add_collection(faces)
    axes.set_aspect("equal")
    axes.autoscale_view()
    axes.set_axis_off()
