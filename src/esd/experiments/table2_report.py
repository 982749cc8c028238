"""What the comparison of table 2 shows, in tables and sentences."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from esd.common import BoolArray, FloatArray
from esd.datasets.collection import Collection
from esd.experiments.comparison import LANDMARKS, RADII, Group, percent_right
from esd.experiments.costs import Cost
from esd.experiments.paper import TABLE2
from esd.experiments.report import Report, Table
from esd.learning.model import Model


def table2_report(
    groups: Sequence[Group],
    models: Mapping[str, Model],
    costs: Mapping[str, Cost],
    seen: Collection,
    held_out: Collection,
    excluded: BoolArray | None,
) -> Report:
    """The tables of the comparison, and what became of the paper's claims.

    Parameters
    ----------
    seen, held_out
        What models were trained and validated on.
    excluded : (points,)
        Points of the template that are left out, if any are.
    """
    points = int(np.mean([len(errors) for group in groups for errors in group.errors["HKS"]]))
    without = (
        "No parts of the body are known of these shapes, so that nothing is excluded"
        if excluded is None
        else f"Heads, hands and feet ({excluded.mean():.0%} of the points) are excluded"
    )
    tables = [
        _accuracy_table("table2", "Share of correct matches", groups, models, mirrored=False),
        TABLE2,
        _pairs_table(groups, models),
        _curves_table(groups, models),
        _costs_table(models, costs),
        _training_table(models),
    ]
    if groups[0].mirrored:
        caption = "The same where the mirror image of the true vertex counts as correct, too"
        tables.insert(1, _accuracy_table("mirrored", caption, groups, models, mirrored=True))
    return Report(
        "The embedding beside other learned descriptors (table 2)",
        (
            f"{len(groups[0].pairs)} pairs a group, {points} points a pair: a tenth of the "
            f"source's vertices that have a counterpart, drawn by area. {without}. Each is mapped "
            "to the nearest vertex in each descriptor; nothing is rejected or refined. A match is "
            "correct within 5 % of the geodesic diameter. The disparity of two shapes is the mean "
            f"difference of the geodesic distances between {LANDMARKS} points, as a share of "
            "their mean, both for unit area; RSD is the standard deviation over pairs over the "
            "mean.",
            f"All methods were trained on the same {len(seen.shapes)} shapes of "
            f"{', '.join(seen.subjects)}, until the loss on {len(held_out.shapes)} shapes of "
            f"{', '.join(held_out.subjects)} had stopped falling or the preset's steps were done; "
            "the weights are those with the lowest. `oriented` is not in the paper: it is this "
            "package's default recipe, here without its remeshed copies of the training shapes.",
            _finding(groups, models, costs),
        ),
        tuple(tables),
    )


def _accuracy_table(
    name: str, caption: str, groups: Sequence[Group], models: Mapping[str, Model], *, mirrored: bool
) -> Table:
    rows = []
    for number, group in enumerate(groups, start=1):
        errors = group.mirrored if mirrored else group.errors
        shares = [percent_right(errors[method]) for method in models]
        cells = [cell for share in shares for cell in (float(share.mean()), _deviation(share))]
        rows.append((number, group.subjects, float(group.disparity.mean()), *cells))
    return Table(
        name,
        f"{caption}: means over pairs in percent, and RSD",
        (
            "group",
            "subjects",
            "disparity %",
            *(f"{method} {what}" for method in models for what in ("%", "RSD")),
        ),
        tuple(rows),
    )


def _deviation(shares: FloatArray) -> float | None:
    """Standard deviation over mean; None where there is none."""
    return float(np.std(shares, ddof=1) / shares.mean()) if shares.mean() > 0 else None


def _pairs_table(groups: Sequence[Group], models: Mapping[str, Model]) -> Table:
    rows = [
        (
            number,
            source.name,
            target.name,
            float(group.disparity[i]),
            len(group.errors["HKS"][i]),
            *(float(group.accuracies(method)[i]) for method in models),
        )
        for number, group in enumerate(groups, start=1)
        for i, (source, target) in enumerate(group.pairs)
    ]
    header = ("group", "source", "target", "disparity %", "points", *(f"{m} %" for m in models))
    return Table("pairs", "Share of correct matches of each pair", header, tuple(rows), shown=False)


def _curves_table(groups: Sequence[Group], models: Mapping[str, Model]) -> Table:
    rows = []
    for number, group in enumerate(groups, start=1):
        curves = [100 * group.curve(method) for method in models]
        rows += [
            (number, float(100 * radius), *(float(curve[i]) for curve in curves))
            for i, radius in enumerate(RADII)
        ]
    return Table(
        "curves",
        "Share of points within an error in percent of the diameter",
        ("group", "error %", *(f"{method} %" for method in models)),
        tuple(rows),
        shown=False,
    )


def _costs_table(models: Mapping[str, Model], costs: Mapping[str, Cost]) -> Table:
    rows = []
    for name, model in models.items():
        curve = training_curve(model)
        best = min(curve, key=lambda look: look[2])[0] if curve else None
        seconds = model.card.get("training_cpu_seconds")
        rows.append(
            (
                name,
                costs[name].seconds,
                costs[name].seconds / costs["EHKS"].seconds,
                costs[name].megabytes,
                seconds,
                None if seconds is None else seconds / models["EHKS"].card["training_cpu_seconds"],
                model.card.get("steps_done"),
                best,
                sum(layer.weight.size + layer.bias.size for layer in model.layers),
            )
        )
    return Table(
        "costs",
        "Processor time to describe one shape, spectrum included, with the largest memory of a "
        "fresh process that does so, and to train, without descriptors and patches",
        (
            "method",
            "a shape, s",
            "over EHKS",
            "memory, MB",
            "training, s",
            "over EHKS",
            "steps",
            "best at step",
            "weights",
        ),
        tuple(rows),
    )


def training_curve(model: Model) -> tuple[tuple[int, float, float], ...]:
    """Step, training loss and validation loss at each look of a model's training."""
    return tuple((step, seen, held) for step, seen, held in model.card.get("curve", ()))


def _training_table(models: Mapping[str, Model]) -> Table:
    rows = [(name, *look) for name, model in models.items() for look in training_curve(model)]
    return Table(
        "training",
        "Mean loss of a pair in training, since the look before, and in validation",
        ("method", "step", "training loss", "validation loss"),
        tuple(rows),
        shown=False,
    )


def _finding(
    groups: Sequence[Group], models: Mapping[str, Model], costs: Mapping[str, Cost]
) -> str:
    """What became of the paper's claims, a line each."""
    names = [name for name in models if f"{name} %" in TABLE2.header]
    columns = [TABLE2.header.index(f"{name} %") for name in names]
    ours = np.array([[group.accuracies(name).mean() for name in names] for group in groups])
    theirs = np.array([[row[i] for i in columns] for row in TABLE2.rows], dtype=float)
    lines = []
    for what, shares in (("Here", ours), ("In the paper, on Dyna", theirs)):
        for number, row in enumerate(shares, start=1):
            order = np.argsort(-row, kind="stable")
            ranked = ", ".join(f"{names[i]} {row[i]:.1f} %" for i in order)
            lines.append(f"- {what}, group {number}: {ranked}.")
    own = names.index("EHKS")
    for what, row in (("Here", ours[-1]), ("In the paper", theirs[-1])):
        others = np.delete(row, own)
        best = int(np.argmax(others))
        rival = [name for name in names if name != "EHKS"][best]
        lines.append(
            f"- {what}, for the most different subjects, EHKS has "
            f"{row[own] / max(others[best], 1e-9):.2f} times the share of {rival}, the best of the "
            "others."
        )
    steady = sum(
        min(names, key=lambda name: _deviation(group.accuracies(name)) or np.inf) == "EHKS"
        for group in groups
    )
    lines.append(
        f"- EHKS has the smallest RSD in {steady} of {len(groups)} groups, in the paper "
        "in all four."
    )
    shape, training = costs["EHKS"].seconds, models["EHKS"].card["training_cpu_seconds"]
    lines += [
        f"- {name} takes {costs[name].seconds / shape:.2f} times as long as EHKS to describe a "
        f"shape, and {models[name].card['training_cpu_seconds'] / training:.2f} times to train."
        for name in names
        if name not in ("HKS", "EHKS")
    ]
    return "\n".join(lines)
