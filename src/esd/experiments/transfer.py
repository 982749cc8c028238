"""Embeddings trained on one collection, tested on another (future work of the paper)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure

from esd.common import InputError
from esd.experiments.counting import correct_matches, drawn_pairs
from esd.experiments.report import Report, Table
from esd.experiments.setting import KINDS, Setting, fingerprint, paper_training, trained
from esd.learning.model import raw_model
from esd.viewing.figures import blank_figure

UNEMBEDDED = "not embedded"


@dataclass(frozen=True, slots=True)
class TransferOutcome:
    """Share of correct matches by (descriptor, trained on, tested on), and the collections."""

    shares: Mapping[tuple[str, str, str], float]
    collections: tuple[str, ...]
    report: Report


def run(*settings: Setting) -> TransferOutcome:
    """Train on the training shapes of each collection, test on the testing shapes of each.

    Raises
    ------
    InputError
        If two collections have one name.
    """
    names = tuple(setting.training.name for setting in settings)
    if len(set(names)) != len(names):
        raise InputError(f"The collections must have different names; got {', '.join(names)}.")
    models = {(kind, UNEMBEDDED): raw_model(kind) for kind in KINDS}
    for name, setting in zip(names, settings, strict=True):
        for kind in KINDS:
            training = paper_training(kind, quick=setting.quick)
            models[kind, name] = trained(setting, f"E{kind.upper()}", training)
    shares: dict[tuple[str, str, str], float] = {}
    deviations: dict[tuple[str, str, str], float] = {}
    for tested, setting in zip(names, settings, strict=True):
        matched = correct_matches(
            setting,
            {f"{kind} {trained_on}": model for (kind, trained_on), model in models.items()},
            drawn_pairs(setting),
            data=fingerprint(setting.testing),
        )
        for (kind, trained_on), found in zip(models, matched, strict=True):
            shares[kind, trained_on, tested] = 100 * float(found.shares.mean())
            deviations[kind, trained_on, tested] = 100 * float(np.std(found.shares, ddof=1))
    matrix = Table(
        "transfer",
        "Share of correct matches in percent, mean over pairs, and deviation over pairs",
        ("descriptor", "trained on", *(f"tested on {name}" for name in names)),
        tuple(
            (
                kind.upper(),
                trained_on,
                *(
                    f"{shares[kind, trained_on, t]:.1f} ± {deviations[kind, trained_on, t]:.1f}"
                    for t in names
                ),
            )
            for kind, trained_on in models
        ),
    )
    finding = "The paper leaves transfer to another training set as future work; it has no figures."
    return TransferOutcome(
        shares, names, Report("Transfer between collections", (finding,), (matrix,))
    )


def figures(outcome: TransferOutcome) -> dict[str, Figure]:
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
