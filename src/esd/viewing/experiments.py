"""The figures of the paper's experiments."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.tri import Triangulation

from esd.experiments.architecture import CHOSEN, CRITERIA, ArchitectureOutcome, Trial
from esd.experiments.setting import KINDS
from esd.experiments.table1 import SHOWN, Table1Outcome
from esd.learning.losses import PairCriteria
from esd.viewing.figures import UNMATCHED, draw_mesh, position_colours

Figures = dict[str, Figure]


def table1_figures(outcome: Table1Outcome) -> Figures:
    """The correct matches of six pairs, source and target side by side, by each descriptor."""
    pairs = outcome.pairs[:SHOWN]
    meshes = [(source.mesh(), target.mesh()) for source, target in pairs]
    extents = np.array([np.ptp(mesh.vertices, axis=0) for pair in meshes for mesh in pair])
    up = "y" if np.median(extents[:, 1]) > np.median(extents[:, 2]) else "z"
    figure = _figure(2.2 * len(outcome.matched), 1.9 * len(pairs))
    cells = figure.subfigures(len(pairs), len(outcome.matched))
    for i, ((source, target), (first, second)) in enumerate(zip(pairs, meshes, strict=True)):
        colours = position_colours(second)
        ends = (first, source.correspondence()), (second, target.correspondence())
        for cell, method in zip(cells[i], outcome.matched, strict=True):
            right = method.correct[i]
            for axes, (mesh, index) in zip(cell.subplots(1, 2), ends, strict=True):
                shown = np.tile(UNMATCHED, (len(mesh.vertices), 1))
                shown[index[right]] = colours[ends[1][1][right]]
                draw_mesh(axes, mesh, shown, up)
            cell.suptitle(f"{method.name}: {method.counts[i]}", fontsize=8)
    return {"matches": figure, "counts": _counts_figure(outcome)}


def _counts_figure(outcome: Table1Outcome) -> Figure:
    figure = _figure(8, 3)
    left, right = figure.subplots(1, 2)
    names = [method.name for method in outcome.matched]
    colours = [f"C{i % len(KINDS)}" for i in range(len(names))]
    for axes, values, title in (
        (left, [method.counts for method in outcome.matched], "correct matches"),
        (right, [100 * method.covered for method in outcome.matched], "area covered, %"),
    ):
        boxes = axes.boxplot(values, tick_labels=names, patch_artist=True, showfliers=False)
        for box, colour in zip(boxes["boxes"], colours, strict=True):
            box.set_facecolor(colour)
        for median in boxes["medians"]:
            median.set_color("black")
        axes.set_title(title, fontsize=9)
    return figure


def architecture_figures(outcome: ArchitectureOutcome) -> Figures:
    """The criteria over the neurons of two hidden layers, one row a descriptor; and by depth."""
    figure = _figure(11, 8)
    panels = figure.subplots(len(KINDS), len(CRITERIA))
    measures = (_LOSS, *_RATES)
    for row, kind in zip(panels, KINDS, strict=True):
        grid = [t for t in outcome.trials if t.kind == kind and len(t.hidden) == 2]
        seed = min(t.seed for t in grid)
        grid = [t for t in grid if t.seed == seed]
        first, second = np.array([t.hidden for t in grid], dtype=float).T
        for axes, name, measure in zip(row, CRITERIA, measures, strict=True):
            values = [measure(trial.testing) for trial in grid]
            shown = axes.tricontourf(Triangulation(first, second), values, levels=14)
            figure.colorbar(shown, ax=axes)
            axes.plot(*CHOSEN[kind], "r+", markersize=10)
            axes.set_title(f"{kind.upper()}: {name}", fontsize=9)
            axes.set_xlabel("neurons, first", fontsize=8)
            axes.set_ylabel("second", fontsize=8)
    return {"architecture": figure, "depth": _depth_figure(outcome.trials)}


def _depth_figure(trials: tuple[Trial, ...]) -> Figure:
    figure = _figure(9, 3.2)
    for axes, kind in zip(figure.subplots(1, len(KINDS)), KINDS, strict=True):
        for place, (what, of) in enumerate(_SIDES.items()):
            groups = [
                [of(t).loss_mean for t in trials if t.kind == kind and len(t.hidden) == depth]
                for depth in (1, 2, 3)
            ]
            boxes = axes.boxplot(
                groups,
                positions=np.arange(1, 4) + 0.36 * place - 0.18,
                widths=0.3,
                patch_artist=True,
                showfliers=False,
                medianprops={"color": "black"},
                label=what,
            )
            for box in boxes["boxes"]:
                box.set_facecolor(f"C{place}")
        axes.set_xticks([1, 2, 3], ["1", "2", "3"])
        axes.set_xlabel("hidden layers")
        axes.set_title(kind.upper())
    figure.axes[0].set_ylabel("loss a pair")
    figure.axes[0].legend(fontsize=8)
    return figure


def _loss_sum(criteria: PairCriteria) -> float:
    return criteria.loss_sum


_LOSS = _loss_sum
_RATES: tuple[Callable[[PairCriteria], float], ...] = (
    lambda criteria: criteria.miss_rate,
    lambda criteria: criteria.false_match_rate,
    lambda criteria: criteria.error_rate,
)
_SIDES: dict[str, Callable[[Trial], PairCriteria]] = {
    "unseen subjects": lambda trial: trial.testing,
    "subjects trained on": lambda trial: trial.training,
}


def _figure(width: float, height: float) -> Figure:
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure
