"""The intrinsic dimension of spectral descriptors (figure 2 of the paper)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from matplotlib import colormaps
from matplotlib.figure import Figure

from esd.common import FloatArray, IntArray
from esd.experiments.report import Report, Table
from esd.experiments.setting import KINDS, Setting, descriptor_table, paper_training
from esd.learning.dimension import components_needed, nearest_neighbours, residual_variances
from esd.learning.table import standardisation
from esd.viewing.figures import blank_figure

NEIGHBOURS = range(6, 26)
"""Numbers of neighbours that the paper tries."""

_SAMPLES = 10_000
_PICKS = 1000
_QUICK_PICKS = 100
_FAR = 100  # a larger neighbourhood, which could show more than 24 dimensions


@dataclass(frozen=True, slots=True)
class DimensionOutcome:
    """Mean residual variance after 0, 1, … components, for each sample and number of neighbours."""

    residuals: Mapping[str, Mapping[int, FloatArray]]
    report: Report


def run(setting: Setting) -> DimensionOutcome:
    """Sample descriptors, analyse the principal components of neighbourhoods among them.

    Noise is analysed beside raw and standardised descriptors: points of an isotropic normal
    distribution in 100 dimensions, which have no low dimension to be found.
    """
    generator = np.random.default_rng(setting.seed)
    samples = {}
    for kind in KINDS:
        table = descriptor_table(
            setting, setting.training, paper_training(kind, quick=setting.quick)
        )
        mean, deviation = standardisation(table)
        finite = np.flatnonzero(np.isfinite(table.values).all(axis=1))
        rows = generator.choice(finite, size=min(_SAMPLES, len(finite)), replace=False)
        raw = table.values[rows].astype(np.float64)
        samples[kind.upper()] = raw
        samples[f"{kind.upper()}, standardised"] = (raw - mean) / deviation
    samples["noise"] = generator.standard_normal((_SAMPLES, 100))

    picks = _QUICK_PICKS if setting.quick else _PICKS
    residuals: dict[str, dict[int, FloatArray]] = {}
    needed: dict[str, dict[int, IntArray]] = {}
    with setting.progress("analysing neighbourhoods", len(samples)) as advance:
        for name, values in samples.items():
            places = generator.choice(len(values), size=min(picks, len(values)), replace=False)
            near = nearest_neighbours(values, places, count=_FAR)
            found = {k: residual_variances(values, near[:, :k]) for k in (*NEIGHBOURS, _FAR)}
            residuals[name] = {k: left.mean(axis=0) for k, left in found.items()}
            needed[name] = {k: components_needed(left) for k, left in found.items()}
            advance(1)
    return DimensionOutcome(residuals, _report(residuals, needed))


def _report(
    residuals: Mapping[str, Mapping[int, FloatArray]],
    needed: Mapping[str, Mapping[int, IntArray]],
) -> Report:
    shown = (6, 10, 15, 20, 25, _FAR)
    components = Table(
        "components",
        "Mean number of principal components that cover 99 % of the variance among k neighbours",
        ("sample", *(f"k = {k}" for k in shown)),
        tuple((name, *(float(counts[k].mean()) for k in shown)) for name, counts in needed.items()),
    )
    left = Table(
        "left",
        "Mean share of the variance left after five components, %",
        ("sample", *(f"k = {k}" for k in shown)),
        tuple(
            (name, *(round(100 * float(curves[k][5]), 6) for k in shown))
            for name, curves in residuals.items()
        ),
    )
    every = Table(
        "residuals",
        "Mean residual variance",
        ("sample", "neighbours", "components", "residual variance"),
        tuple(
            (name, k, count, float(value))
            for name, curves in residuals.items()
            for k, curve in curves.items()
            for count, value in enumerate(curve)
        ),
        shown=False,
    )
    return Report(
        "Intrinsic dimension of spectral descriptors",
        (
            "By the paper, the residual variance drops within five components for k from 6 to 25, "
            "so the intrinsic dimension is 5. k neighbours span k − 1 dimensions at the most: for "
            "k = 6 nothing can be left after five components, as the row of noise shows.",
        ),
        (components, left, every),
    )


def figures(outcome: DimensionOutcome) -> dict[str, Figure]:
    """Residual variance by number of components: raw above, standardised below."""
    figure = blank_figure(9, 5.5)
    panels = figure.subplots(2, len(KINDS), sharex=True, sharey=True)
    colours = colormaps["viridis"](np.linspace(0, 0.9, len(NEIGHBOURS)))
    for row, scaling in zip(panels, ("", ", standardised"), strict=True):
        for axes, kind in zip(row, KINDS, strict=True):
            name = kind.upper() + scaling
            for k, colour in zip(NEIGHBOURS, colours, strict=True):
                axes.plot(outcome.residuals[name][k], color=colour, label=f"k = {k}")
            axes.plot(outcome.residuals["noise"][NEIGHBOURS[-1]], "k:", label="noise, k = 25")
            axes.axhline(0.01, color="grey", linewidth=0.5)
            axes.axvline(5, color="grey", linewidth=0.5)
            axes.set_title(name, fontsize=9)
            axes.set_xlim(0, 15)
    for axes in panels[-1]:
        axes.set_xlabel("principal components")
    for row in panels:
        row[0].set_ylabel("residual variance")
    lines, labels = panels[0, 0].get_legend_handles_labels()
    some = [0, 9, 19, 20]  # k = 6, 15, 25, and noise
    panels[0, -1].legend([lines[i] for i in some], [labels[i] for i in some], fontsize=8)
    return {"dimension": figure}
