"""The embedding beside other learned descriptors (table 2 and figures 7 and 8 of the paper)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from matplotlib.figure import Figure

from esd.common import BoolArray, InputError
from esd.datasets.splits import sample_by_subject, split_by_subject
from esd.experiments.comparison import RADII, Group, matched_groups
from esd.experiments.costs import costs_of
from esd.experiments.pictures import matches_figure
from esd.experiments.report import Report
from esd.experiments.setting import Setting, shortened, trained
from esd.experiments.table2_report import table2_report, training_curve
from esd.learning.model import Model, raw_model
from esd.learning.presets import PRESETS, Training
from esd.viewing.figures import blank_figure, draw_curves

LEARNED = {
    "OSD": "osd",
    "GCNN": "gcnn",
    "ACNN": "acnn",
    "EHKS": "paper-hks",
    "oriented": "oriented",
}
"""Presets by the names that they have in tables; the last is not in the paper."""

TRAINING_SUBJECTS, TESTING_SUBJECTS = 6, 4
"""Numbers of subjects in the paper's comparison."""

_QUICK_POSES = 2

_QUICK_STEPS = {"osd": 40, "gcnn": 300, "acnn": 150, "paper-hks": 1000, "oriented": 300}

_QUICK_VALIDATIONS = 5

_EXCLUDED = ("head", "hand", "foot")


@dataclass(frozen=True, slots=True)
class Table2Outcome:
    """Groups from one subject alone to the most different two; and how the methods came about."""

    groups: tuple[Group, ...]
    models: Mapping[str, Model]
    report: Report


def run(setting: Setting) -> Table2Outcome:
    """Match pairs of increasingly different subjects by nearest neighbours in each descriptor.

    As in the paper, ten pairs in each of four groups, all with sources of the testing subject with
    the smallest area: targets of the same subject, and of the others in the order of their
    disparity, which is measured. A tenth of the vertices is matched, drawn evenly over the
    surface, without head, hands and feet; nothing is rejected.

    Raises
    ------
    InputError
        If there are fewer than two subjects to train on or to test on.
    """
    if len(setting.training.subjects) < 2 or len(setting.testing.subjects) < 2:
        raise InputError(
            "The comparison needs two subjects or more to train on and to test on; got "
            f"{len(setting.training.subjects)} and {len(setting.testing.subjects)}."
        )
    seen, held_out = split_by_subject(
        setting.training, held_out=max(1, len(setting.training.subjects) // 3), seed=setting.seed
    )
    if setting.quick:
        seen, held_out = (sample_by_subject(part, _QUICK_POSES) for part in (seen, held_out))
    learning = replace(setting, training=seen)
    models = {"HKS": raw_model("hks")}
    for name, preset in LEARNED.items():
        training = _training(preset, quick=setting.quick)
        models[name] = trained(learning, name, training, validation=held_out)
    excluded = _excluded(setting)
    groups = matched_groups(setting, models, excluded)
    costs = costs_of(setting, models)
    return Table2Outcome(
        groups, models, table2_report(groups, models, costs, seen, held_out, excluded)
    )


def _training(preset: str, *, quick: bool) -> Training:
    """A preset on the given shapes alone, as all methods; in few steps to be quick."""
    training = replace(PRESETS[preset], remeshings=0)
    if not quick:
        return training
    short = shortened(training, _QUICK_STEPS[preset])
    return replace(short, validate_every=max(1, short.steps // _QUICK_VALIDATIONS))


def _excluded(setting: Setting) -> BoolArray | None:
    """Which points of the template are of head, hands and feet; None where no parts are known."""
    for shape in (*setting.testing.shapes, *setting.training.shapes):
        if shape.parts is not None:
            return np.array([any(part in name for part in _EXCLUDED) for name in shape.parts()])
    return None


def figures(outcome: Table2Outcome) -> dict[str, Figure]:
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
        "matches": matches_figure(rows),
        "training": _training_figure(outcome),
    }


def _training_figure(outcome: Table2Outcome) -> Figure:
    curves = {name: np.array(training_curve(model)) for name, model in outcome.models.items()}
    curves = {name: array for name, array in curves.items() if len(array)}
    figure = blank_figure(2.9 * len(curves), 2.8)
    for axes, (name, array) in zip(
        figure.subplots(1, len(curves), squeeze=False)[0], curves.items(), strict=True
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
