"""Pictures that several experiments share."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from esd.common import BoolArray
from esd.datasets.collection import Shape
from esd.experiments.counting import CorrectMatches
from esd.experiments.setting import KINDS
from esd.viewing.colours import UNMATCHED, position_colours
from esd.viewing.figures import axis_up, blank_figure, draw_mesh


def matches_figure(
    rows: Sequence[tuple[tuple[Shape, Shape], Mapping[str, BoolArray]]],
) -> Figure:
    """Pairs, source and target side by side, once for each method, coloured where it is right.

    Parameters
    ----------
    rows
        Source and target, and by the title of each method which points of the template are right.
    """
    meshes = [(source.mesh(), target.mesh()) for (source, target), _ in rows]
    up = axis_up(mesh for pair in meshes for mesh in pair)
    count = len(rows[0][1])
    figure = blank_figure(2.2 * count, 1.9 * len(rows))
    cells: Any = figure.subfigures(len(rows), count, squeeze=False)
    for line, ((source, target), methods), (first, second) in zip(cells, rows, meshes, strict=True):
        colours = position_colours(second)
        ends = (first, source.correspondence()), (second, target.correspondence())
        for cell, (title, right) in zip(line, methods.items(), strict=True):
            for axes, (mesh, index) in zip(cell.subplots(1, 2), ends, strict=True):
                shown = np.tile(UNMATCHED, (len(mesh.vertices), 1))
                shown[index[right]] = colours[ends[1][1][right]]
                draw_mesh(axes, mesh, shown, up)
            cell.suptitle(title, fontsize=8)
    return figure


def counts_figure(matched: Sequence[CorrectMatches]) -> Figure:
    """Correct matches and covered area, a box over the pairs for each method."""
    figure = blank_figure(8, 3)
    left, right = figure.subplots(1, 2)
    names = [method.name for method in matched]
    colours = [f"C{i % len(KINDS)}" for i in range(len(names))]
    for axes, values, title in (
        (left, [method.counts for method in matched], "correct matches"),
        (right, [100 * method.covered for method in matched], "area covered, %"),
    ):
        boxes = axes.boxplot(values, tick_labels=names, patch_artist=True, showfliers=False)
        for box, colour in zip(boxes["boxes"], colours, strict=True):
            box.set_facecolor(colour)
        for median in boxes["medians"]:
            median.set_color("black")
        axes.set_title(title, fontsize=9)
    return figure
