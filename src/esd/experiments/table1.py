"""Correct matches of each descriptor and of its embedding (table 1 and figure 6 of the paper)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure

from esd.datasets.collection import Shape
from esd.experiments.counting import CorrectMatches, correct_matches, drawn_pairs, summary
from esd.experiments.paper import TABLE1, TABLE1_POINTS
from esd.experiments.pictures import counts_figure, matches_figure
from esd.experiments.report import Report, Table
from esd.experiments.setting import KINDS, Setting, fingerprint, paper_training, trained
from esd.learning.model import raw_model

SHOWN = 6  # pairs of the paper's table
_SIGNED = "GPS, true signs"


@dataclass(frozen=True, slots=True)
class Table1Outcome:
    """Matches by each descriptor; the first six pairs are those of the figure."""

    pairs: tuple[tuple[Shape, Shape], ...]
    matched: tuple[CorrectMatches, ...]
    report: Report


def run(setting: Setting) -> Table1Outcome:
    """Count the correct matches of GPS, HKS, WKS and their embeddings on unseen subjects.

    As in the paper: nearest neighbours; embedded pairs beyond the threshold C / 2 are rejected,
    raw descriptors have none; matches with an error above 5 % of the diameter are rejected.
    """
    pairs = drawn_pairs(setting)
    models = {kind.upper(): raw_model(kind) for kind in KINDS}
    for kind in KINDS:
        name = f"E{kind.upper()}"
        models[name] = trained(setting, name, paper_training(kind, quick=setting.quick))
    models[_SIGNED] = raw_model("gps")
    data = fingerprint(setting.testing)
    *matched, signed = correct_matches(setting, models, pairs, data=data, true_signs=[_SIGNED])
    return Table1Outcome(pairs, tuple(matched), _report(pairs, matched, signed))


def _report(
    pairs: Sequence[tuple[Shape, Shape]], matched: Sequence[CorrectMatches], signed: CorrectMatches
) -> Report:
    points = len(matched[0].correct[0])
    header = ("source", "target", *(method.name for method in matched))
    rows = [
        (source.name, target.name, *(int(method.counts[i]) for method in matched))
        for i, (source, target) in enumerate(pairs)
    ]
    names = [kind.upper() for kind in KINDS]
    means = summary("means", (*matched, signed), compared={f"E{name}": name for name in names})
    return Report(
        "Correct matches of descriptors and their embeddings (table 1)",
        (
            f"Each of {points} points is mapped to the nearest descriptor. Embedded matches "
            "beyond C / 2 are rejected; a match is correct within 5 % of the geodesic diameter. "
            "An area is covered within 2 % of the diameter of a correct match.",
            _finding(matched, points),
            f"With the signs of its columns set by the true map, GPS has {signed.counts.mean():.0f}"
            f" correct matches instead of {matched[0].counts.mean():.0f}: so much of its failure "
            "is due to arbitrary signs. This is no method, since it needs the answer.",
        ),
        (
            Table("table1", "Correct matches, six pairs", header, tuple(rows[:SHOWN])),
            TABLE1,
            means,
            Table("pairs", "Correct matches, all pairs", header, tuple(rows), shown=False),
        ),
    )


def _finding(matched: Sequence[CorrectMatches], points: int) -> str:
    ours = {method.name: method.counts.mean() for method in matched}
    covered = {method.name: method.covered.mean() for method in matched}
    theirs = {
        name: np.mean([row[2 + i] for row in TABLE1.rows])
        for i, name in enumerate(TABLE1.header[2:])
    }
    return "\n".join(
        f"- The embedding of {name} has {ours[f'E{name}'] / ours[name]:.2f} times as many correct "
        f"matches as {name} ({ours[f'E{name}']:.0f} against {ours[name]:.0f} of {points}); in the "
        f"paper, on Dyna, {theirs[f'E{name}'] / theirs[name]:.2f} times "
        f"({theirs[f'E{name}']:.0f} against {theirs[name]:.0f} of {TABLE1_POINTS}). They cover "
        f"{covered[f'E{name}']:.0%} of the body against {covered[name]:.0%}."
        for name in map(str.upper, KINDS)
    )


def figures(outcome: Table1Outcome) -> dict[str, Figure]:
    """The correct matches of six pairs, source and target side by side, by each descriptor."""
    rows = [
        (pair, {f"{m.name}: {m.counts[i]}": m.correct[i] for m in outcome.matched})
        for i, pair in enumerate(outcome.pairs[:SHOWN])
    ]
    return {"matches": matches_figure(rows), "counts": counts_figure(outcome.matched)}
