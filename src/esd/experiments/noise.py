"""Noise in position and connectivity, and missing parts (the paper's section on noise)."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.stats import rankdata

from esd.common import BoolArray, FloatArray, IntArray
from esd.datasets.collection import Shape
from esd.datasets.parts import Perturbed
from esd.datasets.perturb import PERTURBATIONS
from esd.descriptors.recipe import recipe_spectrum
from esd.evaluation.errors import geodesic_errors
from esd.experiments.counting import NEAR, drawn_pairs, models_key
from esd.experiments.report import Report, Table
from esd.experiments.setting import Setting, fingerprint
from esd.learning.model import Model, load_model
from esd.matching.correspondence import Correspondence
from esd.matching.features import Features, shape_features
from esd.matching.match import match_features
from esd.mesh.geodesics import geodesic_diameter, geodesic_graph
from esd.mesh.mesh import Mesh
from esd.mesh.repair.repair import repair
from esd.spectral.cache import Arrays, Cache, content_key

MODELS = {"HKS": "hks", "EHKS": "paper-hks", "default": "default"}
"""Models that come with the package, by their names in tables and figures."""

CLEAN = "nothing"
"""Name of the noise that shapes have before any is made."""

PARTIAL = ("holes", "cut")
"""Noise that takes parts away."""

THRESHOLDS = np.linspace(0, 1, 101)
"""Of the confidence above which a vertex is said to have a counterpart."""

_AS_THEY_ARE = ("HKS", "EHKS")
_PAIRS = 4
_QUICK_PAIRS = 1


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


@dataclass(frozen=True, slots=True, eq=False)
class NoiseOutcome:
    """All maps, those of clean shapes first, and the disturbed shapes of the first pair.

    Parameters
    ----------
    shown
        Disturbed shapes by noise and level.
    points : (points,)
        The vertex of each point on the first source before it was disturbed.
    """

    maps: tuple[NoisyMaps, ...]
    shown: Mapping[tuple[str, float], Perturbed]
    points: IntArray
    report: Report

    def series(self, noise: str, model: str) -> tuple[NoisyMaps, ...]:
        """Maps by rising level of a noise, the clean ones first."""
        return _series(self.maps, noise, model)


def run(setting: Setting) -> NoiseOutcome:
    """Match shapes that are disturbed more and more to clean shapes of other subjects.

    Disturbed shapes are repaired as `match` does unasked; but for the paper's descriptors their
    holes stay and their noise, which its claim is about. Where parts are missing, the clean shape
    is mapped to the rest, too, to see whether confidence tells what has no counterpart there.
    """
    models = {name: load_model(model) for name, model in MODELS.items()}
    pairs = drawn_pairs(setting)[: _QUICK_PAIRS if setting.quick else _PAIRS]
    grid = [(CLEAN, 0.0)] + [
        (name, level)
        for name, kind in PERTURBATIONS.items()
        for level in (kind.levels[1::2] if setting.quick else kind.levels)
    ]
    parts: dict[tuple[str, float], list[Arrays]] = {step: [] for step in grid}
    with setting.progress("matching disturbed shapes", len(pairs) * len(grid)) as went:
        for place, pair in enumerate(pairs):
            matched = _matching(setting, models, pair, seed=setting.seed + place)
            found = []
            for name, level in grid:
                found.append(matched(name, level))
                went(1)
            for part, arrays in zip(
                parts.values(), _with_errors(setting, pair[1], found), strict=True
            ):
                part.append(arrays)
    maps = tuple(
        _joined(several, name, level, model, place)
        for (name, level), several in parts.items()
        for place, model in enumerate(models)
    )
    first = pairs[0][0]
    shown = {
        (name, level): _disturbed(name, first.mesh(), level, seed=setting.seed)
        for name, level in grid
    }
    return NoiseOutcome(maps, shown, first.correspondence(), _report(pairs, maps))


def _disturbed(noise: str, mesh: Mesh, level: float, *, seed: int) -> Perturbed:
    if noise == CLEAN:
        return Perturbed(mesh, np.arange(len(mesh.vertices)))
    return PERTURBATIONS[noise].disturb(mesh, level, seed=seed)


def _described(models: Mapping[str, Model], mesh: Mesh, kept: Cache | None) -> dict[str, Features]:
    """A shape in the eyes of all models."""
    # all of `MODELS` take the same spectrum
    recipe = next(iter(models.values())).recipe
    plain, restored = repair(mesh), repair(mesh, restore=True)
    as_it_is = as_matched = (plain, recipe_spectrum(recipe, plain.shape, cache=kept))
    if restored.done != plain.done:
        as_matched = (restored, recipe_spectrum(recipe, restored.shape, cache=kept))
    described = {}
    for name, model in models.items():
        shape, pairs = as_it_is if name in _AS_THEY_ARE else as_matched
        described[name] = shape_features(shape, model=model, pairs=pairs)
    return described


def _matches(
    models: Mapping[str, Model], source: Mapping[str, Features], target: Mapping[str, Features]
) -> tuple[Correspondence, ...]:
    return tuple(
        match_features(source[name], target[name], model=model, refine=None, one_to_one=False)
        for name, model in models.items()
    )


def _matching(
    setting: Setting, models: Mapping[str, Model], pair: tuple[Shape, Shape], *, seed: int
) -> Callable[[str, float], Arrays]:
    """A function that matches a pair at a level of a noise, and keeps what it found."""
    source, target = pair
    key, data = models_key(models), fingerprint(setting.testing)

    @cache
    def clean() -> dict[str, Features]:
        return _described(models, target.mesh(), setting.cache)

    def matched(noise: str, level: float) -> Arrays:
        part = content_key(
            "noise",
            models=key,
            data=data,
            pair=[source.name, target.name],
            noise=noise,
            level=level,
            seed=seed,
        )
        return setting.store.computed(
            part, lambda: _maps_of_pair(models, pair, clean(), noise, level, seed=seed)
        )

    return matched


def _maps_of_pair(
    models: Mapping[str, Model],
    pair: tuple[Shape, Shape],
    clean: Mapping[str, Features],
    noise: str,
    level: float,
    *,
    seed: int,
) -> Arrays:
    """What `NoisyMaps` holds of one pair, (models, points) each, with vertices for errors."""
    source, target = pair
    there = target.correspondence()
    disturbed = _disturbed(noise, source.mesh(), level, seed=seed)
    here = _followed(source.correspondence(), disturbed.vertex_index)
    rest = _described(models, disturbed.mesh, None)
    forth = _matches(models, rest, clean)
    reverse = np.full((len(models), len(there)), np.nan)
    if noise in PARTIAL:
        reverse[:] = [_at(found.confidence, there) for found in _matches(models, clean, rest)]
    return {
        "predicted": np.stack([_followed(here, found.target_index) for found in forth]),
        "confidence": np.stack([_at(found.confidence, here) for found in forth]),
        "verdicts": np.array(
            [found.judgement.verdict if found.judgement else "" for found in forth]
        ),
        "reverse": reverse,
        "present": here >= 0,
    }


def _with_errors(setting: Setting, target: Shape, parts: Sequence[Arrays]) -> list[Arrays]:
    """The parts of one pair with the errors of their maps as shares of the target's diameter."""
    predicted = np.stack([part["predicted"] for part in parts])
    truths = [target.correspondence()]
    if target.symmetric is not None:
        truths.append(target.symmetric())

    def compute() -> Arrays:
        # all at once, so that each vertex is the source of distances only once
        graph = geodesic_graph(target.mesh())
        found = geodesic_errors(
            graph,
            predicted.ravel(),
            tuple(np.tile(truth, predicted[..., 0].size) for truth in truths),
        )
        diameter = geodesic_diameter(target.mesh(), graph=graph)
        errors = {"errors": found[0], "nearer": np.fmin.reduce(found)}
        # on another piece, infinitely far
        return {
            name: np.minimum(error / diameter, 1).reshape(predicted.shape)
            for name, error in errors.items()
        }

    key = content_key(
        "noise-errors", predicted, *truths, data=fingerprint(setting.testing), target=target.name
    )
    found = setting.store.computed(key, compute)
    return [
        {**part, "errors": errors, "nearer": nearer}
        for part, errors, nearer in zip(parts, found["errors"], found["nearer"], strict=True)
    ]


def _followed(index: IntArray, next_index: IntArray) -> IntArray:
    """Where vertices, −1 for none, go by a map."""
    return np.where(index >= 0, next_index[index], -1)


def _at(values: FloatArray, index: IntArray) -> FloatArray:
    """Values at vertices; NaN at −1."""
    return np.where(index >= 0, values[index], np.nan)


def _joined(parts: Sequence[Arrays], noise: str, level: float, model: str, place: int) -> NoisyMaps:
    arrays = {
        name: np.stack([part[name][place] for part in parts])
        for name in ("errors", "nearer", "confidence", "reverse")
    }
    return NoisyMaps(
        noise,
        level,
        model,
        verdicts=tuple(str(part["verdicts"][place]) for part in parts),
        present=np.stack([part["present"] for part in parts]),
        **arrays,
    )


def _series(maps: Sequence[NoisyMaps], noise: str, model: str) -> tuple[NoisyMaps, ...]:
    return tuple(one for one in maps if one.noise in (CLEAN, noise) and one.model == model)


def mean_error(maps: NoisyMaps) -> float:
    """Mean over pairs of the mean error of each, up to left and right, in percent."""
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
    with_one, without = int(has.sum()), int((~has).sum())
    if not with_one or not without:
        return float("nan")
    ranks = rankdata(confidence)[has].sum()
    return float((ranks - with_one * (with_one + 1) / 2) / (with_one * without))


def _report(pairs: Sequence[tuple[Shape, Shape]], maps: Sequence[NoisyMaps]) -> Report:
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
        clean, *_, worst = _series(maps, noise, model)
        before, after = mean_error(clean), mean_error(worst)
        words.append(f"{model} from {before:.1f} to {after:.1f} % ({after - before:+.1f})")
    level = f"{worst.level:g} ({PERTURBATIONS[noise].unit})"
    return f"- {noise.capitalize()}, from none to {level}: {', '.join(words)}."


def _errors_table(maps: Sequence[NoisyMaps]) -> Table:
    rows = []
    for noise in PERTURBATIONS:
        series = [_series(maps, noise, model) for model in MODELS]
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
        "Mean error, percent of the diameter, up to left and right; and of the default model to "
        "the true vertex alone",
        ("noise", "level", *MODELS, "default, true side"),
        tuple(rows),
    )


def _verdicts_table(maps: Sequence[NoisyMaps]) -> Table:
    """What the default model says of its maps, beside what they are."""
    rows = []
    for noise in PERTURBATIONS:
        for one in _series(maps, noise, "default"):
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
