"""Noise in position and connectivity, and missing parts (the paper's section on noise)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from matplotlib import colormaps
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from scipy.spatial import KDTree

from esd.common import FloatArray, IntArray
from esd.datasets.collection import Shape
from esd.datasets.parts import Perturbed
from esd.datasets.perturb import PERTURBATIONS
from esd.descriptors.recipe import recipe_spectrum
from esd.evaluation.errors import cumulative_curve, errors_on_target, truth_of
from esd.experiments.counting import drawn_pairs, models_key
from esd.experiments.noisy_maps import (
    CLEAN,
    MODELS,
    PARTIAL,
    THRESHOLDS,
    NoisyMaps,
    mean_error,
    noise_report,
    precision_recall,
    series_of,
)
from esd.experiments.report import Report
from esd.experiments.setting import Setting, fingerprint
from esd.learning.model import Model, load_model
from esd.matching.correspondence import Correspondence
from esd.matching.features import Features, shape_features
from esd.matching.match import match_features
from esd.mesh.mesh import Mesh
from esd.mesh.repair.repair import repair
from esd.spectral.cache import Arrays, Cache, content_key
from esd.viewing.figures import axis_up, blank_figure, draw_mesh

_AS_THEY_ARE = ("HKS", "EHKS")

_PAIRS = 4

_QUICK_PAIRS = 1


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
        return series_of(self.maps, noise, model)


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
    with setting.progress("matching disturbed shapes", len(pairs) * len(grid)) as advance:
        for place, pair in enumerate(pairs):
            matched = _matching(setting, models, pair, seed=setting.seed + place)
            found = []
            for name, level in grid:
                found.append(matched(name, level))
                advance(1)
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
    return NoiseOutcome(maps, shown, first.correspondence(), noise_report(pairs, maps))


def _disturbed(noise: str, mesh: Mesh, level: float, *, seed: int) -> Perturbed:
    if noise == CLEAN:
        return Perturbed(mesh, np.arange(len(mesh.vertices)))
    return PERTURBATIONS[noise].disturb(mesh, level, seed=seed)


def _features(models: Mapping[str, Model], mesh: Mesh, cache: Cache | None) -> dict[str, Features]:
    """Features of a shape by all models."""
    # all of `MODELS` take the same spectrum
    recipe = next(iter(models.values())).recipe
    plain, smoothed = repair(mesh), repair(mesh, restore=True)
    as_it_is = as_matched = (plain, recipe_spectrum(recipe, plain.shape, cache=cache))
    if smoothed.done != plain.done:
        as_matched = (smoothed, recipe_spectrum(recipe, smoothed.shape, cache=cache))
    features = {}
    for name, model in models.items():
        shape, spectrum = as_it_is if name in _AS_THEY_ARE else as_matched
        features[name] = shape_features(shape, model=model, spectrum=spectrum)
    return features


def _matches(
    models: Mapping[str, Model], source: Mapping[str, Features], target: Mapping[str, Features]
) -> tuple[Correspondence, ...]:
    return tuple(
        match_features(source[name], target[name], model=model, refine=None)
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
        return _features(models, target.mesh(), setting.cache)

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
    rest = _features(models, disturbed.mesh, None)
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
    truth = truth_of(target)
    truths = [truth.index] if truth.symmetric is None else [truth.index, truth.symmetric]

    def compute() -> Arrays:
        found = errors_on_target(truth, predicted.reshape(-1, predicted.shape[-1]))
        return {
            name: (errors / found.diameter).reshape(predicted.shape)
            for name, errors in (("errors", found.direct), ("nearer", found.nearer))
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


_WORST = 0.25  # of the diameter, where the paper's colours end

_STYLES = {"HKS": "C0s--", "EHKS": "C1o-", "default": "C2D-"}


def figures(outcome: NoiseOutcome) -> dict[str, Figure]:
    """Errors by level, their distribution, what confidence tells of missing parts, and pictures."""
    painted = {
        f"painted-{noise.replace(' ', '-')}": _painted(outcome, noise) for noise in PERTURBATIONS
    }
    return {
        "errors": _errors(outcome),
        "curves": _curves(outcome),
        "counterparts": _counterparts(outcome),
        **painted,
    }


def _errors(outcome: NoiseOutcome) -> Figure:
    """Mean error over the level, a panel a noise; bars are standard deviations over pairs."""
    figure = blank_figure(2.4 * len(PERTURBATIONS), 2.8)
    panels = figure.subplots(1, len(PERTURBATIONS), sharey=True)
    for axes, (noise, kind) in zip(panels, PERTURBATIONS.items(), strict=True):
        for model, style in _STYLES.items():
            series = outcome.series(noise, model)
            deviation = [100 * np.nanmean(maps.nearer, axis=1).std() for maps in series]
            levels, means = [maps.level for maps in series], [mean_error(maps) for maps in series]
            axes.errorbar(
                levels, means, deviation, fmt=style, markersize=3, elinewidth=0.6, label=model
            )
        axes.set_title(noise, fontsize=9)
        axes.set_xlabel(kind.unit, fontsize=8)
        axes.grid(alpha=0.3)
    panels[0].set_ylim(bottom=0)
    panels[0].set_ylabel("mean error, % of the diameter", fontsize=8)
    panels[0].legend(fontsize=7)
    return figure


def _curves(outcome: NoiseOutcome) -> Figure:
    """Share of points within an error, a row a model, a column a noise, a line a level."""
    figure = blank_figure(2.4 * len(PERTURBATIONS), 2 * len(MODELS))
    panels = figure.subplots(len(MODELS), len(PERTURBATIONS), sharex=True, sharey=True)
    radii = np.linspace(0, _WORST, 101)
    for row, model in zip(panels, MODELS, strict=True):
        for axes, noise in zip(row, PERTURBATIONS, strict=True):
            series = outcome.series(noise, model)
            for maps, colour in zip(series, _shades(series), strict=True):
                known = maps.nearer[np.isfinite(maps.nearer)]
                share = 100 * cumulative_curve(known, radii)
                axes.plot(100 * radii, share, color=colour, label=f"{maps.level:g}")
            axes.set(xlim=(0, 100 * _WORST), ylim=(0, 100))
            axes.grid(alpha=0.3)
            axes.set_title(f"{model}, {noise}", fontsize=8)
            if model == next(iter(MODELS)):
                axes.legend(fontsize=6, loc="lower right")
        row[0].set_ylabel("points, %", fontsize=8)
    for axes in panels[-1]:
        axes.set_xlabel("error, % of the diameter", fontsize=8)
    return figure


def _counterparts(outcome: NoiseOutcome) -> Figure:
    """Precision over recall of 'has a counterpart', a row a model, a column a noise."""
    figure = blank_figure(3 * len(PARTIAL), 2.4 * len(MODELS))
    panels = figure.subplots(len(MODELS), len(PARTIAL), sharex=True, sharey=True)
    for row, model in zip(panels, MODELS, strict=True):
        for axes, noise in zip(row, PARTIAL, strict=True):
            series = outcome.series(noise, model)[1:]
            for maps, colour in zip(series, _shades(series), strict=True):
                precision, recall = precision_recall(maps, THRESHOLDS)
                axes.plot(100 * recall, 100 * precision, color=colour, label=f"{maps.level:g}")
                share = 100 * maps.counterparts()[1].mean()
                axes.axhline(share, color=colour, linewidth=0.6, linestyle=":")
            axes.set_title(f"{model}, {noise}", fontsize=8)
            axes.set(xlim=(0, 101), ylim=(40, 101))
            axes.grid(alpha=0.3)
            if model == next(iter(MODELS)):
                axes.legend(fontsize=6, loc="lower left", title="level", title_fontsize=6)
        row[0].set_ylabel("precision, %", fontsize=8)
    for axes in panels[-1]:
        axes.set_xlabel("recall, %", fontsize=8)
    return figure


def _painted(outcome: NoiseOutcome, noise: str) -> Figure:
    """Errors on the first disturbed shape, a row a model, a column a level, as in the paper.

    Vertices that are no point of the template are painted as the nearest that is one.
    """
    columns = len(outcome.series(noise, "default"))
    figure = blank_figure(1.7 * columns + 0.6, 2.3 * len(MODELS))
    panels = figure.subplots(len(MODELS), columns)
    scale = ScalarMappable(Normalize(0, 100 * _WORST), "viridis")
    up = axis_up(shown.mesh for shown in outcome.shown.values())
    for row, model in zip(panels, MODELS, strict=True):
        for axes, maps in zip(row, outcome.series(noise, model), strict=True):
            shown = outcome.shown[maps.noise, maps.level]
            vertex = np.where(outcome.points >= 0, shown.vertex_index[outcome.points], -1)
            known = (vertex >= 0) & np.isfinite(maps.nearer[0])
            places = shown.mesh.vertices[vertex[known]]
            _, nearest = KDTree(places).query(shown.mesh.vertices)
            colours = scale.to_rgba(100 * maps.nearer[0, known])[nearest, :3]
            draw_mesh(axes, shown.mesh, colours, up)
            mean = 100 * maps.nearer[0, known].mean()
            axes.set_title(f"{model}, {maps.level:g}: {mean:.1f} %", fontsize=7)
    figure.colorbar(scale, ax=panels, shrink=0.5, extend="max", label="error, % of the diameter")
    return figure


def _shades(series: Sequence[NoisyMaps]) -> FloatArray:
    """Colours that grow lighter with the level."""
    return np.asarray(colormaps["viridis"](np.linspace(0, 0.9, len(series))))
