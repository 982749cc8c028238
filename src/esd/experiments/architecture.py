"""How many hidden layers, and how many neurons (figure 5 of the paper)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, astuple, dataclass, fields, replace
from itertools import groupby, pairwise, product

import numpy as np
from matplotlib.figure import Figure
from matplotlib.tri import Triangulation

from esd.experiments.report import Report, Table
from esd.experiments.setting import KINDS, Setting, descriptor_table, shortened
from esd.learning.losses import PairCriteria
from esd.learning.presets import PRESETS, Training
from esd.learning.table import PointTable, standardisation
from esd.spectral.cache import Arrays, content_key
from esd.viewing.figures import blank_figure

CHOSEN = {"gps": (20, 18), "hks": (78, 32), "wks": (78, 32)}
"""The paper's choice."""

_LARGEST = {"gps": 25, "hks": 100, "wks": 100}
_SMALLEST = 16  # even numbers, among which the paper's choices are
_BATCH = 64  # pairs in a step; fewer than the paper's 512, for about 950 trainings
_STEPS = 1000
_QUICK_STEPS = 200
_AT_ONCE = 32  # networks whose weights and activations stay in a processor's cache
_REPEATS = 10  # trainings of the chosen networks by other seeds, which tell the noise


@dataclass(frozen=True, slots=True)
class Trial:
    """One training: of which descriptor, how wide, by which seed, and how it did."""

    kind: str
    hidden: tuple[int, ...]
    seed: int
    training: PairCriteria
    testing: PairCriteria


@dataclass(frozen=True, slots=True)
class ArchitectureOutcome:
    """All trainings, and what they show."""

    trials: tuple[Trial, ...]
    report: Report


def grid(kind: str, *, depth: int, step: int) -> tuple[tuple[int, ...], ...]:
    """Widths of hidden layers, none wider than the one before it, in steps from 16."""
    widths = range(_SMALLEST, _LARGEST[kind] + 1, step)
    every = product(widths, repeat=depth)
    return tuple(h for h in every if all(a >= b for a, b in pairwise(h)))


def run(setting: Setting) -> ArchitectureOutcome:
    """Train networks of one, two and three hidden layers on some subjects, judge them on others.

    One hidden layer and two go through widths in steps of 2, three in steps of 16 (2 for GPS).
    """
    trials = tuple(trial for kind in KINDS for trial in _trials(setting, kind))
    return ArchitectureOutcome(trials, _report(setting, trials))


def best(trials: tuple[Trial, ...], kind: str, *, depth: int) -> Trial:
    """The training with the lowest loss on the unseen subjects."""
    grid_seed = min(t.seed for t in trials)
    found = [t for t in trials if (t.kind, len(t.hidden), t.seed) == (kind, depth, grid_seed)]
    return min(found, key=lambda trial: trial.testing.loss_mean)


def _plan(setting: Setting, kind: str) -> list[tuple[int, tuple[int, ...]]]:
    """Seed and widths of each training, those that are trained at once next to each other."""
    fine, coarse = (2, 2) if kind == "gps" else (16, 32) if setting.quick else (2, 16)
    plan = [
        (setting.seed, hidden)
        for depth, step in ((1, fine), (2, fine), (3, coarse))
        for hidden in grid(kind, depth=depth, step=step)
    ]
    repeats = 2 if setting.quick else _REPEATS
    first, second = CHOSEN[kind]
    compared = [(first,), (first, second), (first, second, second)]
    plan += [(setting.seed + 1 + i, hidden) for hidden in compared for i in range(repeats)]
    return sorted(plan, key=lambda item: (len(item[1]), item[0], item[1]))


def _trials(setting: Setting, kind: str) -> list[Trial]:
    from esd.learning.architecture import judge_many, train_many  # which need torch

    training = replace(
        shortened(PRESETS[f"paper-{kind}"], _QUICK_STEPS if setting.quick else _STEPS),
        batch=_BATCH,
    )
    tables = _standardised(setting, training)
    plan = _plan(setting, kind)
    chunks = [
        (seed, [hidden for _, hidden in group][at : at + _AT_ONCE])
        for (_, seed), items in groupby(plan, key=lambda item: (len(item[1]), item[0]))
        for group in [list(items)]
        for at in range(0, len(group), _AT_ONCE)
    ]
    data = content_key("tables", *(t.values for t in tables), *tables[0].rows, *tables[1].rows)
    trials = []
    with setting.progress(f"training {len(plan)} networks on {kind}", len(plan)) as advance:
        for seed, hidden in chunks:

            def compute(seed: int = seed, hidden: list[tuple[int, ...]] = hidden) -> Arrays:
                networks = train_many(tables[0], training, hidden, seed=seed)
                return {
                    name: np.array([astuple(c) for c in judge_many(networks, table, training)])
                    for name, table in zip(("training", "testing"), tables, strict=True)
                }

            key = content_key(
                f"architecture-{kind}",
                data=data,
                training=asdict(training),
                hidden=hidden,
                seed=seed,
            )
            found = setting.store.computed(key, compute)
            trials += [
                Trial(kind, h, seed, PairCriteria(*a.tolist()), PairCriteria(*b.tolist()))
                for h, a, b in zip(hidden, found["training"], found["testing"], strict=True)
            ]
            advance(len(hidden))
    return trials


def _standardised(setting: Setting, training: Training) -> tuple[PointTable, PointTable]:
    raw = [
        descriptor_table(setting, data, training) for data in (setting.training, setting.testing)
    ]
    mean, deviation = standardisation(raw[0])
    return raw[0].standardised(mean, deviation), raw[1].standardised(mean, deviation)


def _report(setting: Setting, trials: tuple[Trial, ...]) -> Report:
    measured = tuple(field.name for field in fields(PairCriteria))
    rows = [
        (
            t.kind,
            len(t.hidden),
            " ".join(map(str, t.hidden)),
            t.seed,
            *astuple(t.testing),
            *astuple(t.training),
        )
        for t in trials
    ]
    header = ("descriptor", "depth", "neurons", "seed")
    every = Table(
        "trials",
        "Every training, judged on pairs of unseen subjects and of those trained on",
        header + measured + tuple(f"training_{name}" for name in measured),
        tuple(rows),
        shown=False,
    )
    return Report(
        "Architecture of the network",
        (
            "Loss a pair, on pairs of subjects that the network never saw. Trainings are shorter "
            f"({_QUICK_STEPS if setting.quick else _STEPS} steps of {_BATCH} pairs) than those of "
            "the paper's presets. By the paper, two hidden layers are better than one, three "
            "overfit, and 78 and 32 neurons (HKS, WKS) or 20 and 18 (GPS) are adequate.",
        ),
        (_depths(setting, trials), _choices(setting, trials), every),
    )


def _depths(setting: Setting, trials: tuple[Trial, ...]) -> Table:
    rows = []
    for kind in KINDS:
        for depth in (1, 2, 3):
            group = [
                t for t in trials if (t.kind, len(t.hidden), t.seed) == (kind, depth, setting.seed)
            ]
            unseen = np.array([t.testing.loss_mean for t in group])
            seen = np.array([t.training.loss_mean for t in group])
            found = best(trials, kind, depth=depth)
            rows.append(
                (
                    kind.upper(),
                    depth,
                    len(group),
                    float(np.median(unseen)),
                    float(np.median(seen)),
                    found.testing.loss_mean,
                    _widths(found.hidden),
                    100 * found.testing.error_rate,
                )
            )
    return Table(
        "depths",
        "Depth: loss a pair over all widths, and the best of them",
        (
            "descriptor",
            "hidden layers",
            "networks",
            "median loss",
            "median loss, seen subjects",
            "lowest loss",
            "its neurons",
            "its ERR %",
        ),
        tuple(rows),
    )


def _choices(setting: Setting, trials: tuple[Trial, ...]) -> Table:
    """The paper's choice among the grid, beside the noise of the seed."""
    rows = []
    for kind in KINDS:
        first, second = CHOSEN[kind]
        for hidden in ((first,), (first, second), (first, second, second)):
            repeats = np.array(
                [
                    t.testing.loss_mean
                    for t in trials
                    if (t.kind, t.hidden) == (kind, hidden) and t.seed != setting.seed
                ]
            )
            of_depth = np.array(
                [
                    t.testing.loss_mean
                    for t in trials
                    if (t.kind, len(t.hidden), t.seed) == (kind, len(hidden), setting.seed)
                ]
            )
            rows.append(
                (
                    kind.upper(),
                    _widths(hidden),
                    len(repeats),
                    float(repeats.mean()),
                    float(repeats.std(ddof=1)),
                    float((of_depth < repeats.mean()).mean()),
                )
            )
    return Table(
        "choices",
        "The paper's choice, and the same with a layer less and a layer more, by further seeds",
        (
            "descriptor",
            "neurons",
            "seeds",
            "mean loss",
            "deviation over seeds",
            "share of the grid of this depth that is better",
        ),
        tuple(rows),
    )


def _widths(hidden: tuple[int, ...]) -> str:
    return "–".join(map(str, hidden))


_MEASURES: dict[str, Callable[[PairCriteria], float]] = {
    "LSS": lambda criteria: criteria.loss_sum,
    "TNR, %": lambda criteria: 100 * criteria.miss_rate,
    "FPR, %": lambda criteria: 100 * criteria.false_match_rate,
    "ERR, %": lambda criteria: 100 * criteria.error_rate,
}  # by the names they have in the paper
# by the names they have in the paper
_SIDES: dict[str, Callable[[Trial], PairCriteria]] = {
    "unseen subjects": lambda trial: trial.testing,
    "subjects trained on": lambda trial: trial.training,
}


def figures(outcome: ArchitectureOutcome) -> dict[str, Figure]:
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
