"""The figures of the experiment on noise."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib import colormaps
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from scipy.spatial import KDTree

from esd.common import FloatArray
from esd.datasets.perturb import PERTURBATIONS
from esd.evaluation.errors import cumulative_curve
from esd.experiments.noise import (
    MODELS,
    PARTIAL,
    THRESHOLDS,
    NoiseOutcome,
    NoisyMaps,
    mean_error,
    precision_recall,
)
from esd.viewing.figures import axis_up, blank_figure, draw_mesh

_WORST = 0.25  # of the diameter, where the paper's colours end
_STYLES = {"HKS": "C0s--", "EHKS": "C1o-", "default": "C2D-"}


def noise_figures(outcome: NoiseOutcome) -> dict[str, Figure]:
    """Errors by level, their distribution, what confidence tells of missing parts, and pictures."""
    painted = {
        f"painted-{noise.replace(' ', '-')}": _painted(outcome, noise) for noise in PERTURBATIONS
    }
    return {
        "errors": _errors(outcome),
        "curves": _curves(outcome),
        "counterparts": _counterparts(outcome),
        **painted,
    }


def _errors(outcome: NoiseOutcome) -> Figure:
    """Mean error over the level, a panel a noise; bars are standard deviations over pairs."""
    figure = blank_figure(2.4 * len(PERTURBATIONS), 2.8)
    panels = figure.subplots(1, len(PERTURBATIONS), sharey=True)
    for axes, (noise, kind) in zip(panels, PERTURBATIONS.items(), strict=True):
        for model, style in _STYLES.items():
            series = outcome.series(noise, model)
            deviation = [100 * np.nanmean(maps.nearer, axis=1).std() for maps in series]
            levels, means = [maps.level for maps in series], [mean_error(maps) for maps in series]
            axes.errorbar(
                levels, means, deviation, fmt=style, markersize=3, elinewidth=0.6, label=model
            )
        axes.set_title(noise, fontsize=9)
        axes.set_xlabel(kind.unit, fontsize=8)
        axes.grid(alpha=0.3)
    panels[0].set_ylim(bottom=0)
    panels[0].set_ylabel("mean error, % of the diameter", fontsize=8)
    panels[0].legend(fontsize=7)
    return figure


def _curves(outcome: NoiseOutcome) -> Figure:
    """Share of points within an error, a row a model, a column a noise, a line a level."""
    figure = blank_figure(2.4 * len(PERTURBATIONS), 2 * len(MODELS))
    panels = figure.subplots(len(MODELS), len(PERTURBATIONS), sharex=True, sharey=True)
    radii = np.linspace(0, _WORST, 101)
    for row, model in zip(panels, MODELS, strict=True):
        for axes, noise in zip(row, PERTURBATIONS, strict=True):
            series = outcome.series(noise, model)
            for maps, colour in zip(series, _shades(series), strict=True):
                known = maps.nearer[np.isfinite(maps.nearer)]
                share = 100 * cumulative_curve(known, radii)
                axes.plot(100 * radii, share, color=colour, label=f"{maps.level:g}")
            axes.set(xlim=(0, 100 * _WORST), ylim=(0, 100))
            axes.grid(alpha=0.3)
            axes.set_title(f"{model}, {noise}", fontsize=8)
            if model == next(iter(MODELS)):
                axes.legend(fontsize=6, loc="lower right")
        row[0].set_ylabel("points, %", fontsize=8)
    for axes in panels[-1]:
        axes.set_xlabel("error, % of the diameter", fontsize=8)
    return figure


def _counterparts(outcome: NoiseOutcome) -> Figure:
    """Precision over recall of 'has a counterpart', a row a model, a column a noise."""
    figure = blank_figure(3 * len(PARTIAL), 2.4 * len(MODELS))
    panels = figure.subplots(len(MODELS), len(PARTIAL), sharex=True, sharey=True)
    for row, model in zip(panels, MODELS, strict=True):
        for axes, noise in zip(row, PARTIAL, strict=True):
            series = outcome.series(noise, model)[1:]
            for maps, colour in zip(series, _shades(series), strict=True):
                precision, recall = precision_recall(maps, THRESHOLDS)
                axes.plot(100 * recall, 100 * precision, color=colour, label=f"{maps.level:g}")
                share = 100 * maps.counterparts()[1].mean()
                axes.axhline(share, color=colour, linewidth=0.6, linestyle=":")
            axes.set_title(f"{model}, {noise}", fontsize=8)
            axes.set(xlim=(0, 101), ylim=(40, 101))
            axes.grid(alpha=0.3)
            if model == next(iter(MODELS)):
                axes.legend(fontsize=6, loc="lower left", title="level", title_fontsize=6)
        row[0].set_ylabel("precision, %", fontsize=8)
    for axes in panels[-1]:
        axes.set_xlabel("recall, %", fontsize=8)
    return figure


def _painted(outcome: NoiseOutcome, noise: str) -> Figure:
    """Errors on the first disturbed shape, a row a model, a column a level, as in the paper.

    Vertices that are no point of the template are painted as the nearest that is one.
    """
    columns = len(outcome.series(noise, "default"))
    figure = blank_figure(1.7 * columns + 0.6, 2.3 * len(MODELS))
    panels = figure.subplots(len(MODELS), columns)
    scale = ScalarMappable(Normalize(0, 100 * _WORST), "viridis")
    up = axis_up(shown.mesh for shown in outcome.shown.values())
    for row, model in zip(panels, MODELS, strict=True):
        for axes, maps in zip(row, outcome.series(noise, model), strict=True):
            shown = outcome.shown[maps.noise, maps.level]
            vertex = np.where(outcome.points >= 0, shown.vertex_index[outcome.points], -1)
            known = (vertex >= 0) & np.isfinite(maps.nearer[0])
            places = shown.mesh.vertices[vertex[known]]
            _, nearest = KDTree(places).query(shown.mesh.vertices)
            colours = scale.to_rgba(100 * maps.nearer[0, known])[nearest, :3]
            draw_mesh(axes, shown.mesh, colours, up)
            mean = 100 * maps.nearer[0, known].mean()
            axes.set_title(f"{model}, {maps.level:g}: {mean:.1f} %", fontsize=7)
    figure.colorbar(scale, ax=panels, shrink=0.5, extend="max", label="error, % of the diameter")
    return figure


def _shades(series: Sequence[NoisyMaps]) -> FloatArray:
    """Colours that grow lighter with the level."""
    return np.asarray(colormaps["viridis"](np.linspace(0, 0.9, len(series))))
