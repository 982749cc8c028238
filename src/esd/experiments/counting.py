"""Correct matches, as the paper counts them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np

from esd.common import BoolArray, FloatArray, IntArray
from esd.datasets.collection import Shape
from esd.evaluation.errors import NEAR, Truth, errors_on_target, truth_of
from esd.experiments.report import Table
from esd.experiments.setting import Setting
from esd.learning.model import Model
from esd.mesh.geodesics import geodesic_diameter, geodesic_graph
from esd.mesh.geometry import vertex_areas
from esd.nearest import nearest
from esd.spectral.cache import Arrays, content_key

REACH = 0.02  # of the geodesic diameter of the source: a match covers what lies nearer
_PAIRS = 60
_QUICK_PAIRS = 12


@dataclass(frozen=True, slots=True, eq=False)
class CorrectMatches:
    """How one descriptor matches some pairs.

    Parameters
    ----------
    name
        Of the model.
    correct : for each pair (points,)
        Whether each point of the template is matched, is not rejected, and is mapped to within
        5 % of the target's geodesic diameter of where it belongs.
    covered : (pairs,)
        Share of the source's area within 2 % of its geodesic diameter of a correct match.
    """

    name: str
    correct: tuple[BoolArray, ...]
    covered: FloatArray

    @property
    def counts(self) -> IntArray:
        """Number of correct matches, (pairs,)."""
        return np.array([right.sum() for right in self.correct])

    @property
    def shares(self) -> FloatArray:
        """The same over the number of points, (pairs,)."""
        return np.array([right.mean() for right in self.correct])


@dataclass(frozen=True, slots=True, eq=False)
class Embedded:
    """Where the points of the template lie on a shape, and its embedding by several models."""

    truth: Truth
    values: Mapping[str, FloatArray]


def drawn_pairs(setting: Setting) -> tuple[tuple[Shape, Shape], ...]:
    """At most 60 pairs of different unseen subjects, drawn by the seed; 12 to be quick."""
    every = setting.testing.pairs()
    order = np.random.default_rng(setting.seed).permutation(len(every))
    return tuple(every[i] for i in order[: _QUICK_PAIRS if setting.quick else _PAIRS])


def correct_matches(
    setting: Setting,
    models: Mapping[str, Model],
    pairs: Sequence[tuple[Shape, Shape]],
    *,
    data: str,
    true_signs: Sequence[str] = (),
) -> tuple[CorrectMatches, ...]:
    """How models match pairs by nearest neighbours; each target is kept when it is finished.

    Models with a margin reject matches beyond their threshold; raw descriptors have none.

    Parameters
    ----------
    models
        By the names they have in tables.
    data
        The `fingerprint` of the shapes.
    true_signs
        Names of models whose values on the target get, column by column, the sign that the true
        map gives them. That needs the answer: it tells what arbitrary signs cost.
    """
    embedded = embedder(setting, models)
    key = models_key(models)
    correct: dict[tuple[str, int], BoolArray] = {}
    with setting.progress(f"matching by {', '.join(models)}", len(pairs)) as advance:
        for group in _places([target for _, target in pairs]):
            target = pairs[group[0]][1]
            sources = [pairs[place][0] for place in group]

            def compute(target: Shape = target, sources: list[Shape] = sources) -> Arrays:
                found = _correct_on_target(
                    embedded(target), [embedded(source) for source in sources], models, true_signs
                )
                return {f"{name} {i}": right for (name, i), right in found.items()}

            part = content_key(
                "matches",
                models=key,
                data=data,
                target=target.name,
                sources=[source.name for source in sources],
                signs=list(true_signs),
            )
            found = setting.store.computed(part, compute)
            correct |= {
                (name, place): found[f"{name} {i}"]
                for i, place in enumerate(group)
                for name in models
            }
            advance(len(group))
    results = {name: tuple(correct[name, i] for i in range(len(pairs))) for name in models}
    covered = _covered(setting, results, pairs)
    return tuple(CorrectMatches(name, results[name], covered[name]) for name in models)


def summary(name: str, matched: Sequence[CorrectMatches], *, compared: Mapping[str, str]) -> Table:
    """Means and deviations over pairs, a row a method.

    Parameters
    ----------
    compared
        For some methods, the one that they are compared with pair by pair.
    """
    by_name = {method.name: method for method in matched}
    return Table(
        name,
        f"Means over {len(matched[0].correct)} pairs, and standard deviations over pairs",
        (
            "descriptor",
            "correct matches",
            "deviation",
            "share %",
            "deviation %",
            "covered area %",
            "deviation %",
            "compared with",
            "pairs with more %",
        ),
        tuple(
            _summary_row(method, by_name.get(compared.get(method.name, ""))) for method in matched
        ),
    )


def _summary_row(method: CorrectMatches, other: CorrectMatches | None) -> tuple[object, ...]:
    measures = (method.counts, 100 * method.shares, 100 * method.covered)
    return (
        method.name,
        *(float(f) for m in measures for f in (np.mean(m), np.std(m, ddof=1))),
        None if other is None else other.name,
        None if other is None else 100 * float((method.counts > other.counts).mean()),
    )


def models_key(models: Mapping[str, Model]) -> str:
    """A key of all that the embeddings of some models depend on."""
    arrays = [
        array
        for model in models.values()
        for array in (
            model.mean,
            model.deviation,
            *(a for layer in model.layers for a in (layer.weight, layer.bias)),
        )
    ]
    settings = [
        (
            name,
            model.recipe.to_json(),
            model.margin,
            model.limit,
            model.unit_length,
            model.patches and asdict(model.patches),
        )
        for name, model in models.items()
    ]
    return content_key("models", *arrays, settings=settings)


def embedder(setting: Setting, models: Mapping[str, Model]) -> Callable[[Shape], Embedded]:
    """A function that embeds a shape by several models, each shape once."""
    known: dict[str, Embedded] = {}

    def embedded(shape: Shape) -> Embedded:
        if shape.name not in known:
            truth = truth_of(shape)
            values = {
                name: model.embed_mesh(truth.mesh, cache=setting.cache)
                for name, model in models.items()
            }
            known[shape.name] = Embedded(truth, values)
        return known[shape.name]

    return embedded


def _places(shapes: Sequence[Shape]) -> list[list[int]]:
    """The places at which each shape of a sequence is, shapes in order of first appearance."""
    places: dict[str, list[int]] = {}
    for place, shape in enumerate(shapes):
        places.setdefault(shape.name, []).append(place)
    return list(places.values())


def _correct_on_target(
    target: Embedded,
    sources: Sequence[Embedded],
    models: Mapping[str, Model],
    true_signs: Sequence[str],
) -> dict[tuple[str, int], BoolArray]:
    truth = replace(target.truth, symmetric=None)
    keys, predicted = [], []
    for i, source in enumerate(sources):
        points = source.truth.index
        shared = (points >= 0) & (truth.index >= 0)
        for name, model in models.items():
            values = target.values[name]
            if name in true_signs:
                alike = source.values[name][points[shared]]
                values = values * np.sign((alike * values[truth.index[shared]]).sum(axis=0))
            index, distance = nearest(source.values[name], values)
            if model.margin is not None:
                index = np.where(distance**2 <= model.threshold(), index, -1)
            keys.append((name, i))
            predicted.append(np.where(shared, index[points], -1))
    errors = errors_on_target(truth, np.stack(predicted), limit=NEAR)
    return dict(zip(keys, errors.direct <= NEAR * errors.diameter, strict=True))


def _covered(
    setting: Setting,
    results: Mapping[str, Sequence[BoolArray]],
    pairs: Sequence[tuple[Shape, Shape]],
) -> dict[str, FloatArray]:
    covered: dict[str, FloatArray] = {name: np.empty(len(pairs)) for name in results}
    with setting.progress("measuring coverage", len(pairs)) as advance:
        for group in _places([source for source, _ in pairs]):
            source = pairs[group[0]][0]
            mesh, index = source.mesh(), source.correspondence()
            graph, areas = geodesic_graph(mesh), vertex_areas(mesh)
            radius = REACH * geodesic_diameter(mesh, graph=graph)
            for name, place in ((name, place) for name in results for place in group):
                matched = np.unique(index[results[name][place]])
                near = np.isfinite(graph.distances_to_any(matched, limit=radius))
                covered[name][place] = areas[near].sum() / areas.sum()
            advance(len(group))
    return covered
