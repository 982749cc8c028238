"""The figures of the paper's experiments."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.figure import Figure
from matplotlib.tri import Triangulation

from esd.common import BoolArray
from esd.datasets.collection import Shape
from esd.experiments.architecture import CHOSEN, ArchitectureOutcome, Trial
from esd.experiments.concatenation import ConcatenationOutcome
from esd.experiments.counting import CorrectMatches
from esd.experiments.dimension import NEIGHBOURS, DimensionOutcome
from esd.experiments.scale import FACTORS, ScaleOutcome
from esd.experiments.setting import KINDS
from esd.experiments.table1 import SHOWN, Table1Outcome
from esd.experiments.table2 import RADII, Table2Outcome, training_curve
from esd.experiments.transfer import UNEMBEDDED, TransferOutcome
from esd.learning.losses import PairCriteria
from esd.viewing.colours import UNMATCHED, position_colours
from esd.viewing.figures import axis_up, blank_figure, draw_curves, draw_mesh
from esd.viewing.noise import noise_figures as noise_figures

Figures = dict[str, Figure]


def table1_figures(outcome: Table1Outcome) -> Figures:
    """The correct matches of six pairs, source and target side by side, by each descriptor."""
    rows = [
        (pair, {f"{m.name}: {m.counts[i]}": m.correct[i] for m in outcome.matched})
        for i, pair in enumerate(outcome.pairs[:SHOWN])
    ]
    return {"matches": _matches_figure(rows), "counts": _counts_figure(outcome.matched)}


def _matches_figure(
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


def _counts_figure(matched: Sequence[CorrectMatches]) -> Figure:
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


def table2_figures(outcome: Table2Outcome) -> Figures:
    """Curves of the groups, the correct matches of a pair of each, and the trainings' losses."""
    curves = blank_figure(2.9 * len(outcome.groups), 3.6)
    panels = curves.subplots(1, len(outcome.groups), squeeze=False)[0]
    for number, (axes, group) in enumerate(zip(panels, outcome.groups, strict=True), start=1):
        draw_curves(axes, 100 * RADII, {name: group.curve(name) for name in outcome.models})
        axes.set_title(
            f"group {number}: {group.subjects}\ndisparity {group.disparity.mean():.1f} %",
            fontsize=9,
        )
        axes.set_xlabel("error, % of the diameter")
        if number > 1:
            axes.get_legend().remove()
            axes.set_ylabel("")
    rows = [
        (
            group.pairs[0],
            {
                f"{name}: {group.accuracies(name)[0]:.1f} %": group.shown[name]
                for name in outcome.models
            },
        )
        for group in outcome.groups
    ]
    return {
        "curves": curves,
        "matches": _matches_figure(rows),
        "training": _training_figure(outcome),
    }


def _training_figure(outcome: Table2Outcome) -> Figure:
    looks = {name: np.array(training_curve(model)) for name, model in outcome.models.items()}
    looks = {name: array for name, array in looks.items() if len(array)}
    figure = blank_figure(2.9 * len(looks), 2.8)
    for axes, (name, array) in zip(
        figure.subplots(1, len(looks), squeeze=False)[0], looks.items(), strict=True
    ):
        step, training, validation = array.T
        axes.plot(step, training, "-", label="training")
        axes.plot(step, validation, "--", label="validation")
        axes.axvline(step[np.argmin(validation)], color="grey", linewidth=0.8, label="chosen")
        axes.set_title(name, fontsize=9)
        axes.set_xlabel("step")
    figure.axes[0].set_ylabel("loss a pair")
    figure.axes[0].legend(fontsize=8)
    return figure


def dimension_figures(outcome: DimensionOutcome) -> Figures:
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


def concatenation_figures(outcome: ConcatenationOutcome) -> Figures:
    """Correct matches and covered area by each embedding."""
    return {"counts": _counts_figure(outcome.matched)}


def scale_figures(outcome: ScaleOutcome) -> Figures:
    """Share of correct matches by size of the target."""
    figure = blank_figure(9, 3.2)
    panels = figure.subplots(1, len(KINDS), sharey=True)
    for axes, kind in zip(panels, map(str.upper, KINDS), strict=True):
        for name, shares in outcome.shares.items():
            if name.split(",")[0] in (kind, f"E{kind}"):
                style = "x--" if "unit" in name else "o-"
                colour = "C1" if name.startswith("E") else "C0"
                axes.semilogx(FACTORS, shares, style, color=colour, label=name)
        axes.set_xticks(FACTORS, [f"{factor:g}" for factor in FACTORS], minor=False)
        axes.minorticks_off()
        axes.set_xlabel("size of the target")
        axes.legend(fontsize=7, handlelength=3.5)
    panels[0].set_ylabel("correct matches, %")
    return {"scale": figure}


def transfer_figures(outcome: TransferOutcome) -> Figures:
    """Share of correct matches by what was trained on and what was tested on."""
    names = outcome.collections
    rows = (UNEMBEDDED, *names)
    figure = blank_figure(3.2 * len(KINDS), 1 + 0.6 * len(rows))
    shares = np.array(
        [[[outcome.shares[kind, row, test] for test in names] for row in rows] for kind in KINDS]
    )
    for axes, kind, matrix in zip(figure.subplots(1, len(KINDS)), KINDS, shares, strict=True):
        axes.imshow(matrix, vmin=0, vmax=shares.max(), aspect="auto")
        for (i, j), share in np.ndenumerate(matrix):
            colour = "white" if share < 0.6 * shares.max() else "black"
            axes.text(j, i, f"{share:.1f}", ha="center", va="center", color=colour)
        axes.set_xticks(range(len(names)), names)
        axes.set_yticks(range(len(rows)), rows if kind == KINDS[0] else [""] * len(rows))
        axes.set_xlabel("tested on")
        axes.set_title(f"{kind.upper()}, correct %", fontsize=9)
    figure.axes[0].set_ylabel("trained on")
    return {"transfer": figure}


def architecture_figures(outcome: ArchitectureOutcome) -> Figures:
    """The criteria over the neurons of two hidden layers, one row a descriptor; and by depth."""
    figure = blank_figure(11, 8)
    panels = figure.subplots(len(KINDS), len(_MEASURES))
    for row, kind in zip(panels, KINDS, strict=True):
        grid = [t for t in outcome.trials if t.kind == kind and len(t.hidden) == 2]
        seed = min(t.seed for t in grid)
        grid = [t for t in grid if t.seed == seed]
        first, second = np.array([t.hidden for t in grid], dtype=float).T
        for axes, (name, measure) in zip(row, _MEASURES.items(), strict=True):
            values = [measure(trial.testing) for trial in grid]
            shown = axes.tricontourf(Triangulation(first, second), values, levels=14)
            figure.colorbar(shown, ax=axes)
            axes.plot(*CHOSEN[kind], "r+", markersize=10)
            axes.set_title(f"{kind.upper()}: {name}", fontsize=9)
            axes.set_xlabel("neurons, first", fontsize=8)
            axes.set_ylabel("second", fontsize=8)
    return {"architecture": figure, "depth": _depth_figure(outcome.trials)}


def _depth_figure(trials: tuple[Trial, ...]) -> Figure:
    figure = blank_figure(9, 3.2)
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


_MEASURES: dict[str, Callable[[PairCriteria], float]] = {
    "LSS": lambda criteria: criteria.loss_sum,
    "TNR, %": lambda criteria: 100 * criteria.miss_rate,
    "FPR, %": lambda criteria: 100 * criteria.false_match_rate,
    "ERR, %": lambda criteria: 100 * criteria.error_rate,
}  # by the names they have in the paper
_SIDES: dict[str, Callable[[Trial], PairCriteria]] = {
    "unseen subjects": lambda trial: trial.testing,
    "subjects trained on": lambda trial: trial.training,
}
