"""Maps of disturbed shapes, and what they show in figures and sentences."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from esd.common import BoolArray, FloatArray
from esd.datasets.collection import Shape
from esd.datasets.perturb import PERTURBATIONS
from esd.evaluation.errors import NEAR
from esd.evaluation.protocol import separation as separation_of
from esd.experiments.report import Report, Table

MODELS = {"HKS": "hks", "EHKS": "paper-hks", "default": "default"}
"""Models that come with the package, by their names in tables and figures."""


CLEAN = "nothing"
"""Name of the noise that shapes have before any is made."""


PARTIAL = ("holes", "cut")
"""Noise that takes parts away."""


THRESHOLDS = np.linspace(0, 1, 101)
"""Of the confidence above which a vertex is said to have a counterpart."""


@dataclass(frozen=True, slots=True, eq=False)
class NoisyMaps:
    """Maps between shapes disturbed in one way and clean shapes by one model, pair after pair.

    Parameters
    ----------
    noise, level
        Of `PERTURBATIONS`, or `CLEAN` and zero.
    model
        One of `MODELS`.
    errors, nearer : (pairs, points)
        Of the map from the disturbed shape, the geodesic error as a share of the target's
        diameter, and that to the nearer of the true and the mirrored vertex where that is known.
        NaN at points that either shape lacks.
    confidence : (pairs, points)
        Of these matches.
    verdicts : (pairs,)
        On the maps.
    reverse : (pairs, points)
        Of the map from the clean shape to the disturbed one, the confidence at the points that the
        clean one has. NaN elsewhere, and where no parts are missing.
    present : (pairs, points)
        Whether the disturbed shape has the point.
    """

    noise: str
    level: float
    model: str
    errors: FloatArray
    nearer: FloatArray
    confidence: FloatArray
    verdicts: tuple[str, ...]
    reverse: FloatArray
    present: BoolArray

    def counterparts(self) -> tuple[FloatArray, BoolArray]:
        """Confidence of all points of the clean shapes, and whether they have a counterpart."""
        known = np.isfinite(self.reverse)
        return self.reverse[known], self.present[known]


def series_of(maps: Sequence[NoisyMaps], noise: str, model: str) -> tuple[NoisyMaps, ...]:
    """Maps by one model and of one noise by rising level, the clean ones first."""
    return tuple(one for one in maps if one.noise in (CLEAN, noise) and one.model == model)


def mean_error(maps: NoisyMaps) -> float:
    """Mean over pairs of the symmetry-aware mean error of each, in percent."""
    return 100 * float(np.nanmean(np.nanmean(maps.nearer, axis=1)))


def precision_recall(maps: NoisyMaps, thresholds: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Of 'a vertex has a counterpart where its confidence is at least the threshold'.

    Precision is one where no vertex is said to have a counterpart.
    """
    confidence, has = maps.counterparts()
    says = confidence >= thresholds[:, None]
    right = (says & has).sum(axis=1)
    return np.where(says.any(axis=1), right / np.maximum(says.sum(axis=1), 1), 1.0), (
        right / max(int(has.sum()), 1)
    )


def separation(maps: NoisyMaps) -> float:
    """Probability that a vertex with a counterpart has more confidence than one without.

    The area under the curve of true over false positives; NaN where all or none have one.
    """
    confidence, has = maps.counterparts()
    value = separation_of(confidence[has], confidence[~has])
    return float("nan") if value is None else value


def noise_report(pairs: Sequence[tuple[Shape, Shape]], maps: Sequence[NoisyMaps]) -> Report:
    """What noise does to the maps of some pairs."""
    partial = [one for one in maps if one.noise in PARTIAL]
    return Report(
        "Noise in position and connectivity, and missing parts",
        (
            "Disturbed shapes are mapped to clean ones of other subjects; pairs at each level: "
            f"{len(pairs)}. Errors are shares of the target's geodesic diameter, to the nearer of "
            "the true and the mirrored vertex where that is known: HKS and its embedding cannot "
            "tell them apart. The paper names neither levels nor figures; by its text HKS "
            "deteriorates significantly with noise, while its embedding remains quite robust. Both "
            "see shapes as they are. For the default model small holes are filled and noise is "
            "smoothed, as `esd match` does.",
            "\n".join(_growth(maps, noise) for noise in PERTURBATIONS),
        ),
        (
            _errors_table(maps),
            _verdicts_table(maps),
            _counterparts_table(partial),
            Table(
                "thresholds",
                "Precision and recall of 'has a counterpart' by threshold of the confidence",
                ("noise", "level", "model", "threshold", "precision", "recall"),
                tuple(
                    (one.noise, one.level, one.model, *map(float, row))
                    for one in partial
                    for row in zip(THRESHOLDS, *precision_recall(one, THRESHOLDS), strict=True)
                ),
                shown=False,
            ),
        ),
    )


def _growth(maps: Sequence[NoisyMaps], noise: str) -> str:
    """How the error of each model grows, in a line."""
    words = []
    for model in MODELS:
        clean, *_, worst = series_of(maps, noise, model)
        before, after = mean_error(clean), mean_error(worst)
        words.append(f"{model} from {before:.1f} to {after:.1f} % ({after - before:+.1f})")
    level = f"{worst.level:g} ({PERTURBATIONS[noise].unit})"
    return f"- {noise.capitalize()}, from none to {level}: {', '.join(words)}."


def _errors_table(maps: Sequence[NoisyMaps]) -> Table:
    rows = []
    for noise in PERTURBATIONS:
        series = [series_of(maps, noise, model) for model in MODELS]
        for same in zip(*series, strict=True):
            *_, default = same
            rows.append(
                (
                    noise,
                    default.level,
                    *map(mean_error, same),
                    100 * float(np.nanmean(np.nanmean(default.errors, axis=1))),
                )
            )
    return Table(
        "errors",
        "Symmetry-aware mean error, percent of the diameter; and that of the default model to the "
        "true vertex alone",
        ("noise", "level", *MODELS, "default, true side"),
        tuple(rows),
    )


def _verdicts_table(maps: Sequence[NoisyMaps]) -> Table:
    """What the default model says of its maps, beside what they are."""
    rows = []
    for noise in PERTURBATIONS:
        for one in series_of(maps, noise, "default"):
            known = np.isfinite(one.errors)
            right = 100 * (one.errors <= NEAR).sum(axis=1) / known.sum(axis=1)
            said = Counter(one.verdicts)
            rows.append(
                (
                    noise,
                    one.level,
                    float(right.mean()),
                    100 * float(np.nanmean(one.confidence[known])),
                    ", ".join(f"{verdict} {count}" for verdict, count in said.most_common()),
                )
            )
    return Table(
        "verdicts",
        f"The default model: matches within {NEAR:.0%} of the diameter, the share it expects, and "
        "its verdicts",
        ("noise", "level", "right %", "expected %", "verdicts"),
        tuple(rows),
    )


def _counterparts_table(partial: Sequence[NoisyMaps]) -> Table:
    rows = []
    for one in partial:
        confidence, has = one.counterparts()
        precision, recall = precision_recall(one, np.array([0.5]))
        rows.append(
            (
                one.noise,
                one.level,
                one.model,
                100 * float(has.mean()),
                float(confidence[has].mean()),
                float(confidence[~has].mean()) if not has.all() else None,
                separation(one),
                100 * float(precision[0]),
                100 * float(recall[0]),
            )
        )
    return Table(
        "counterparts",
        "Clean shapes mapped to shapes with missing parts: does confidence tell which vertices "
        "have a counterpart? Separation is the probability that one with a counterpart has more "
        "confidence than one without; precision and recall are those of confidence from 0.5",
        (
            "noise",
            "level",
            "model",
            "with counterpart %",
            "their confidence",
            "that of others",
            "separation",
            "precision %",
            "recall %",
        ),
        tuple(rows),
    )
