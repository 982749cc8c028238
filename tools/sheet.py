"""Pictures of all shapes that a tool has generated."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl

from esd.mesh.mesh import Mesh

mpl.use("Agg")
from matplotlib import pyplot as plt


def sheet(
    shapes: Sequence[tuple[str, Mesh]],
    draw: Callable[[Any, Mesh], None],
    path: Path,
    *,
    columns: int,
    size: tuple[float, float],
    dpi: int,
) -> None:
    """Write a picture of named shapes, each drawn on its axis of a grid; its size is in inches."""
    rows = -(-len(shapes) // columns)
    grid = size[0] * columns, size[1] * rows
    figure, axes = plt.subplots(rows, columns, figsize=grid, squeeze=False)
    for axis in axes.ravel():
        axis.axis("off")
    for axis, (name, mesh) in zip(axes.ravel(), shapes, strict=False):
        draw(axis, mesh)
        axis.set_title(name, fontsize=7)
    figure.tight_layout(pad=0.2)
    figure.savefig(path, dpi=dpi)
    plt.close(figure)
