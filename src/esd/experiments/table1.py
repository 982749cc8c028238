"""Correct matches of each descriptor and of its embedding (table 1 and figure 6 of the paper)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from esd.common import BoolArray, FloatArray, IntArray
from esd.datasets.collection import Shape
from esd.evaluation.errors import geodesic_errors
from esd.evaluation.protocol import evaluate
from esd.experiments.paper import TABLE1, TABLE1_POINTS
from esd.experiments.report import Report, Table
from esd.experiments.setting import KINDS, Setting, fingerprint, paper_training, trained
from esd.learning.model import Model, raw_model
from esd.matching.nearest import nearest
from esd.mesh.geodesics import EdgeGraph, geodesic_diameter, geodesic_graph
from esd.mesh.mesh import vertex_areas
from esd.spectral.cache import Arrays, content_key

NEAR = 0.05  # of the geodesic diameter of the target: beyond it a match is wrong
REACH = 0.02  # of the geodesic diameter of the source: a match covers what lies nearer
SHOWN = 6  # pairs of the paper's table
_PAIRS = 200
_QUICK_PAIRS = 20


@dataclass(frozen=True, slots=True, eq=False)
class MatchedPairs:
    """How one descriptor matches the pairs.

    Parameters
    ----------
    name
        As in the paper's table: `HKS` the descriptor, `EHKS` its embedding.
    correct : (pairs, points)
        Whether each point of the template is matched, is not rejected, and is mapped to within
        5 % of the target's geodesic diameter of where it belongs.
    mean_error : (pairs,)
        Of the points that are matched, over the square root of the target's area.
    mean_symmetric_error : (pairs,)
        The same, to the nearer of the true point and its mirror image; NaN where unknown.
    covered : (pairs,)
        Share of the source's area within 2 % of its geodesic diameter of a correct match.
    """

    name: str
    correct: BoolArray
    mean_error: FloatArray
    mean_symmetric_error: FloatArray
    covered: FloatArray

    @property
    def counts(self) -> IntArray:
        """Number of correct matches, (pairs,)."""
        return self.correct.sum(axis=1)


@dataclass(frozen=True, slots=True)
class Table1Outcome:
    """Matches of each descriptor; the first six pairs are those of the figure."""

    pairs: tuple[tuple[Shape, Shape], ...]
    matched: tuple[MatchedPairs, ...]
    report: Report


def run(setting: Setting) -> Table1Outcome:
    """Count the correct matches of GPS, HKS, WKS and their embeddings on unseen subjects.

    As in the paper: nearest neighbours; embedded pairs beyond the threshold C / 2 are rejected,
    raw descriptors have none; matches with an error above 5 % of the diameter are rejected.
    """
    pairs = chosen_pairs(setting)
    models = [
        *(replace(raw_model(kind), name=kind.upper()) for kind in KINDS),
        *(
            trained(setting, f"E{kind.upper()}", paper_training(kind, quick=setting.quick))
            for kind in KINDS
        ),
    ]
    data = fingerprint(setting.testing)
    matched = tuple(matched_pairs(setting, model, pairs, data=data) for model in models)
    signed = _sign_corrected_counts(setting, pairs, data=data)
    return Table1Outcome(pairs, matched, _report(pairs, matched, signed))


def chosen_pairs(setting: Setting) -> tuple[tuple[Shape, Shape], ...]:
    """At most 200 pairs of different unseen subjects, drawn by the seed."""
    every = setting.testing.pairs()
    order = np.random.default_rng(setting.seed).permutation(len(every))
    return tuple(every[i] for i in order[: _QUICK_PAIRS if setting.quick else _PAIRS])


def matched_pairs(
    setting: Setting, model: Model, pairs: Sequence[tuple[Shape, Shape]], *, data: str
) -> MatchedPairs:
    """How a model matches some pairs; kept among the finished parts.

    Parameters
    ----------
    data
        The `fingerprint` of the shapes.
    """

    def compute() -> Arrays:
        with setting.progress(f"matching by {model.name}", len(pairs)) as went:
            _, found = evaluate(
                model,
                pairs,
                reject=model.margin is not None,
                processes=setting.processes,
                cache=setting.cache,
                on_pair=lambda: went(1),
            )
        by_names = {(pair.source, pair.target): pair for pair in found}
        ordered = [by_names[source.name, target.name] for source, target in pairs]
        correct = []
        for (source, target), pair in zip(pairs, ordered, strict=True):
            shared = (source.correspondence() >= 0) & (target.correspondence() >= 0)
            shared[shared] = pair.errors <= NEAR * pair.diameter
            correct.append(shared)
        scale = np.array([pair.square_root_area for pair in ordered])
        symmetric = [
            np.nan if pair.symmetric_errors is None else np.nanmean(pair.symmetric_errors)
            for pair in ordered
        ]
        return {
            "correct": np.array(correct),
            "mean_error": np.array([np.nanmean(pair.errors) for pair in ordered]) / scale,
            "mean_symmetric_error": np.array(symmetric) / scale,
            "covered": _covered(pairs, correct),
        }

    return MatchedPairs(model.name, **setting.store.computed(_key(model, pairs, data), compute))


def _key(model: Model, pairs: Sequence[tuple[Shape, Shape]], data: str) -> str:
    weights = [array for layer in model.layers for array in (layer.weight, layer.bias)]
    return content_key(
        "matched",
        model.mean,
        model.deviation,
        *weights,
        recipe=model.recipe.to_json(),
        margin=model.margin,
        pairs=[(source.name, target.name) for source, target in pairs],
        data=data,
    )


def _covered(pairs: Sequence[tuple[Shape, Shape]], correct: Sequence[BoolArray]) -> FloatArray:
    surfaces: dict[str, tuple[EdgeGraph, float, FloatArray, IntArray]] = {}
    shares = []
    for (source, _), right in zip(pairs, correct, strict=True):
        if source.name not in surfaces:
            mesh = source.mesh()
            graph = geodesic_graph(mesh)
            radius = REACH * geodesic_diameter(mesh, graph=graph)
            surfaces[source.name] = (graph, radius, vertex_areas(mesh), source.correspondence())
        graph, radius, areas, index = surfaces[source.name]
        near = np.isfinite(graph.distances_to_any(np.unique(index[right]), limit=radius))
        shares.append(areas[near].sum() / areas.sum())
    return np.array(shares)


def _sign_corrected_counts(
    setting: Setting, pairs: Sequence[tuple[Shape, Shape]], *, data: str
) -> IntArray:
    """Correct matches of GPS, (pairs,), with the sign of each column set by the true map.

    This needs the answer, so it is no method. It tells how much of the failure of GPS is due to
    the arbitrary signs of the eigenvectors.
    """
    model = raw_model("gps")

    def compute() -> Arrays:
        counts = []
        with setting.progress("matching by GPS with the true signs", len(pairs)) as went:
            for source, target in pairs:
                first, second = source.correspondence(), target.correspondence()
                shared = (first >= 0) & (second >= 0)
                first, second = first[shared], second[shared]
                mesh = target.mesh()
                values = model.embed_mesh(source.mesh(), cache=setting.cache)
                others = model.embed_mesh(mesh, cache=setting.cache)
                signs = np.sign(np.sum(values[first] * others[second], axis=0))
                index, _ = nearest(values[first], others * signs)
                graph = geodesic_graph(mesh)
                [errors] = geodesic_errors(graph, index, (second,))
                counts.append((errors <= NEAR * geodesic_diameter(mesh, graph=graph)).sum())
                went(1)
        return {"counts": np.array(counts)}

    key = _key(replace(model, name="gps-signs", card={}), pairs, data).replace("matched", "signs")
    return setting.store.computed(key, compute)["counts"]


def _report(
    pairs: Sequence[tuple[Shape, Shape]], matched: Sequence[MatchedPairs], signed: IntArray
) -> Report:
    points = matched[0].correct.shape[1]
    names = tuple(method.name for method in matched)
    rows = [
        (source.name, target.name, *(int(method.counts[i]) for method in matched))
        for i, (source, target) in enumerate(pairs)
    ]
    header = ("source", "target", *names)
    six = Table(
        "table1", f"Correct matches among {points} points, six pairs", header, tuple(rows[:SHOWN])
    )
    every = Table("pairs", f"Correct matches, all {len(pairs)} pairs", header, tuple(rows), False)
    raw = {method.name: method for method in matched if method.name in names[: len(KINDS)]}
    means = Table(
        "means",
        f"Means over {len(pairs)} pairs, with the standard deviation over pairs; errors over √area",
        (
            "method",
            "correct matches",
            "deviation",
            "share %",
            "covered area %",
            "mean error x 100",
            "up to left and right",
            "pairs with more than the descriptor %",
        ),
        tuple(_mean_row(method, raw.get(method.name[1:]), points) for method in matched),
    )
    return Report(
        "Correct matches of descriptors and their embeddings (table 1)",
        (*_findings(matched, points), _sign_finding(raw["GPS"], signed)),
        (six, TABLE1, means, every),
    )


def _mean_row(
    method: MatchedPairs, descriptor: MatchedPairs | None, points: int
) -> tuple[object, ...]:
    counts = method.counts
    symmetric = float(np.mean(method.mean_symmetric_error))
    return (
        method.name,
        float(counts.mean()),
        float(counts.std(ddof=1)),
        100 * float(counts.mean()) / points,
        100 * float(method.covered.mean()),
        100 * float(np.nanmean(method.mean_error)),
        None if np.isnan(symmetric) else 100 * symmetric,
        None if descriptor is None else 100 * float((counts > descriptor.counts).mean()),
    )


def _findings(matched: Sequence[MatchedPairs], points: int) -> tuple[str, ...]:
    counted = {method.name: method.counts.mean() for method in matched}
    covered = {method.name: method.covered.mean() for method in matched}
    theirs = {
        name: np.mean([row[2 + i] for row in TABLE1.rows])
        for i, name in enumerate(TABLE1.header[2:])
    }
    sentences = []
    for kind in map(str.upper, KINDS):
        ratio, their_ratio = (c[f"E{kind}"] / c[kind] for c in (counted, theirs))
        sentences.append(
            f"- The embedding of {kind} has {ratio:.2f} times as many correct matches as {kind} "
            f"({counted[f'E{kind}']:.0f} against {counted[kind]:.0f} of {points}); in the paper, "
            f"on Dyna, {their_ratio:.2f} times ({theirs[f'E{kind}']:.0f} against "
            f"{theirs[kind]:.0f} of {TABLE1_POINTS}). They cover {covered[f'E{kind}']:.0%} of the "
            f"body against {covered[kind]:.0%}."
        )
    return ("\n".join(sentences),)


def _sign_finding(gps: MatchedPairs, signed: IntArray) -> str:
    return (
        f"With the signs of its columns set by the true map, GPS has {signed.mean():.0f} correct "
        f"matches instead of {gps.counts.mean():.0f}: so much of its failure is due to the "
        "arbitrary signs. This is no method, since it needs the answer."
    )
