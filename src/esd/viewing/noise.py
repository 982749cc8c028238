"""The figures of the noise study."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib import colormaps
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from esd.evaluation.perturb import PERTURBATIONS
from esd.experiments.noise import NoisyPair
from esd.viewing.figures import draw_mesh

_WORST = 0.25  # of the diameter, where the colours end as in the paper
_UNKNOWN = (0.75, 0.75, 0.75)


def noise_curves(found: Sequence[NoisyPair]) -> Figure:
    """Mean error of each model over the level, a panel for each noise."""
    names = list(dict.fromkeys(pair.noise for pair in found))
    figure = Figure(figsize=(2.6 * len(names), 2.8), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(1, len(names), sharey=True, squeeze=False)[0]
    for axes, name in zip(panels, names, strict=True):
        for model in dict.fromkeys(pair.model for pair in found):
            chosen = [pair for pair in found if (pair.noise, pair.model) == (name, model)]
            levels = sorted({pair.level for pair in chosen})
            means = [
                100 * np.nanmean([pair.mean_error for pair in chosen if pair.level == level])
                for level in levels
            ]
            axes.plot(levels, means, marker="o", markersize=3, label=model)
        axes.set_title(name)
        axes.set_xlabel(PERTURBATIONS[name].unit, fontsize=8)
        axes.set_ylim(bottom=0)
    panels[0].set_ylabel("mean error, % of the diameter")
    panels[0].legend(fontsize=7)
    return figure


def noise_shapes(found: Sequence[NoisyPair], *, up: str = "z") -> Figure:
    """The first pair's errors painted on the disturbed shape: a row a model, a column a noise.

    The strongest level of each noise is shown; colours run from none (dark) to a quarter of the
    diameter and more (bright), and vertices without truth are grey.

    Parameters
    ----------
    up
        The axis, `y` or `z`, that points up in the meshes.
    """
    models = list(dict.fromkeys(pair.model for pair in found))
    names = list(dict.fromkeys(pair.noise for pair in found))
    figure = Figure(figsize=(2 * len(names), 2.6 * len(models)), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(len(models), len(names), squeeze=False)
    for row, model in zip(panels, models, strict=True):
        for axes, name in zip(row, names, strict=True):
            chosen = [pair for pair in found if (pair.noise, pair.model) == (name, model)]
            shown = max(reversed(chosen), key=lambda pair: pair.level)
            colours = colormaps["inferno"](np.clip(shown.errors / _WORST, 0, 1))[:, :3]
            colours[np.isnan(shown.errors)] = _UNKNOWN
            draw_mesh(axes, shown.mesh, colours, up)
            axes.set_title(f"{model}\n{name} {shown.level:g}", fontsize=8)
    return figure
