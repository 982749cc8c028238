"""Evaluation of a model over pairs of shapes with known correspondence."""

from __future__ import annotations

import time
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.stats import rankdata

from esd.common import BoolArray, FloatArray, InputError, IntArray
from esd.datasets.collection import Shape, correspondences
from esd.evaluation.errors import NEAR, Truth, area_under_curve, errors_on_target
from esd.learning.model import Model
from esd.matching.batch import load_features, save_features
from esd.matching.features import Features
from esd.matching.match import match_features, prepared, working_features
from esd.mesh.geometry import surface_area
from esd.mesh.mesh import Mesh
from esd.mesh.repair.repair import repair
from esd.parallel import THIS_PROCESS, Workers, outcomes, shared_folder
from esd.spectral.cache import Cache

_BINS = (0, 0.2, 0.4, 0.6, 0.8, 0.9, 0.95, 1)  # of the confidence


@dataclass(frozen=True, slots=True, eq=False)
class PairErrors:
    """Errors of one map at the p points of the template that both shapes have.

    Parameters
    ----------
    source, target
        Names of the shapes.
    errors, symmetric_errors : (p,)
        Geodesic distance to the true vertex, and to the nearer of the true and the mirrored one,
        in units of length; NaN where the map has no match. The second is None where no mirrored
        truth is known.
    confidence : (p,)
        Of the matches.
    square_root_area, diameter
        Of the target, in units of length.
    coverage
        Share of the target's vertices that some source vertex is mapped to.
    lone_confidence : (q,)
        Of the matches of the points that the source has and the target lacks.
    lone_matched : (q,)
        Whether these are matched, which is wrong.
    verdict, expected_accuracy
        Of the map, see `esd.matching.confidence.Judgement`; None where it was not judged.
    """

    source: str
    target: str
    errors: FloatArray
    symmetric_errors: FloatArray | None
    confidence: FloatArray
    square_root_area: float
    diameter: float
    coverage: float
    lone_confidence: FloatArray
    lone_matched: BoolArray
    verdict: str | None = None
    expected_accuracy: float | None = None

    def right(self) -> BoolArray:
        """Whether each match is within 5 % of the target's geodesic diameter of the truth, (p,)."""
        return self.errors <= NEAR * self.diameter

    def overlap_iou(self) -> float:
        """Intersection over union of the points that are matched and those with a counterpart."""
        matched = np.isfinite(self.errors).sum()
        return float(matched / max(len(self.errors) + self.lone_matched.sum(), 1))

    def overlap_balanced_accuracy(self) -> float | None:
        """Mean of the shares of points with a counterpart matched and of others not matched.

        None where all points or none have a counterpart.
        """
        if not len(self.errors) or not len(self.lone_matched):
            return None
        return float(np.isfinite(self.errors).mean() + 1 - self.lone_matched.mean()) / 2

    def confidence_separation(self) -> float | None:
        """Probability that a point with a counterpart has more confidence than one without.

        None where all points or none have a counterpart.
        """
        return separation(self.confidence, self.lone_confidence)


@dataclass(frozen=True, slots=True)
class ConfidenceBin:
    """The matches whose confidence is from `low` to below `high`, of all pairs together.

    Parameters
    ----------
    share
        Of all matches.
    confidence
        Their mean.
    right
        Share of them within 5 % of the geodesic diameter of the truth; those that have no
        counterpart are wrong.
    """

    low: float
    high: float
    share: float
    confidence: float
    right: float


@dataclass(frozen=True, slots=True)
class VerdictCount:
    """The maps with one verdict.

    Parameters
    ----------
    maps
        Their number.
    expected
        Mean of the accuracies that they were expected to have.
    right, least_right
        Mean and least of the share of points with a counterpart that are within 5 % of the
        geodesic diameter of it.
    """

    maps: int
    expected: float
    right: float
    least_right: float


@dataclass(frozen=True, slots=True)
class Evaluation:
    """Figures over all pairs: means over pairs of the figures of each, unless said otherwise.

    Parameters
    ----------
    mean_geodesic_error_x100, median_geodesic_error_x100
        100 times the error over √area. Points without a match are left out.
    symmetric_mean_geodesic_error_x100
        The mean with the nearer of the true and the mirrored vertex; None where unknown.
    accuracy_5pct_diameter
        Share of the points with an error of at most 5 % of the geodesic diameter; points without
        a match count as wrong.
    auc
        Area under the cumulative curve of error over √area from 0 to 0.25, between 0 and 1.
    coverage
        Share of the target's vertices that are matched.
    worst_pair_x100
        Largest mean error of a pair, 100 times over √area.
    matched
        Share of the points with a counterpart that have a match.
    overlap_iou, overlap_balanced_accuracy, confidence_separation
        How well the map tells points with a counterpart from those without, see `PairErrors`; None
        where each point of a source has a counterpart.
    calibration_error
        Mean difference of the confidence and the share of right matches over `confidence_bins`.
    pairs
        Number of pairs.
    seconds
        Wall time.
    verdicts
        What the maps with each verdict are like.
    confidence_bins
        How many of the matches of a confidence are right.
    """

    mean_geodesic_error_x100: float
    median_geodesic_error_x100: float
    symmetric_mean_geodesic_error_x100: float | None
    accuracy_5pct_diameter: float
    auc: float
    coverage: float
    worst_pair_x100: float
    matched: float
    overlap_iou: float | None
    overlap_balanced_accuracy: float | None
    confidence_separation: float | None
    calibration_error: float
    pairs: int
    seconds: float
    verdicts: Mapping[str, VerdictCount]
    confidence_bins: tuple[ConfidenceBin, ...]


@dataclass(frozen=True, slots=True)
class _Saved:
    """The name of a shape, and the folder with what was computed of it."""

    name: str
    folder: Path


@dataclass(frozen=True, slots=True, eq=False)
class _EvaluatedShape:
    """A shape as it is matched, and as it is measured.

    Parameters
    ----------
    features
        By which it is matched; maps are between vertices as they are in the file.
    points : (p,)
        Vertex in the file at each point of the template; -1 where it has none.
    truth
        The same on the surface on which errors are measured, repaired but neither filled nor
        smoothed.
    measured_index : (n,)
        The vertex of that surface of each vertex in the file; -1 for none.
    """

    features: Features
    points: IntArray
    truth: Truth
    measured_index: IntArray


def evaluate(
    model: Model,
    pairs: Sequence[tuple[Shape, Shape]],
    *,
    refine: bool | None = None,
    candidates: Sequence[str] | None = None,
    reject: bool = False,
    rotate: int | None = None,
    workers: Workers = THIS_PROCESS,
    cache: Cache | None = None,
    on_step: Callable[[], None] = lambda: None,
) -> tuple[Evaluation, tuple[PairErrors, ...]]:
    """Figures of a model over pairs of shapes, and the errors of each pair, in their order.

    Pairs are matched as by `match`. First the features of each shape are computed, once, and kept
    on disk meanwhile; then the pairs are matched.

    Parameters
    ----------
    pairs
        Source and target shapes.
    refine
        Whether maps are refined by `zoomout`; by default if the model tells left from right.
    candidates
        Names of the maps to choose from, see `esd.matching.match.match`.
    reject
        Whether matches beyond the model's threshold are dropped.
    rotate
        Seed by which each shape is rotated at random, see `randomly_rotated`; by default shapes
        keep the orientation of their files.
    workers
        What computes. Workers of a scheduler must see the files of the shapes, and
        the current folder, under the same names.
    cache
        Where spectra are looked up and kept.
    on_step
        Called after each shape and after each pair, to show progress.

    Raises
    ------
    InputError
        If a shape cannot be read, two have one name, or rejection is asked of a model without a
        margin.
    """
    threshold = model.threshold() if reject else np.inf
    start = time.perf_counter()
    shapes = {shape.name: shape for pair in pairs for shape in pair}
    for shape in (shape for pair in pairs for shape in pair):
        if shape is not shapes[shape.name]:
            raise InputError(f"Two different shapes are called '{shape.name}'; rename one.")
    if rotate is not None:
        shapes = {n: randomly_rotated(shape, seed=rotate) for n, shape in shapes.items()}
    found: list[PairErrors] = []
    with shared_folder(workers) as folder:
        places = {name: _Saved(name, folder / str(i)) for i, name in enumerate(shapes)}
        first = partial(_save, model=model, refine=refine, cache=cache)
        jobs = ((shape, places[name]) for name, shape in shapes.items())
        for computed in outcomes(first, jobs, workers=workers):
            if computed.failure:
                raise InputError(computed.failure_of(computed.job[0].name))
            on_step()
        sources: dict[str, list[_Saved]] = {}
        for source, target in pairs:
            sources.setdefault(target.name, []).append(places[source.name])
        work = partial(
            _errors_on_target,
            model=model,
            refine=refine,
            candidates=candidates,
            threshold=threshold,
            cache=cache,
        )
        groups = ((places[name], group) for name, group in sources.items())
        for matched in outcomes(work, groups, workers=workers):
            if matched.result is None:
                raise InputError(f"'{matched.job[0].name}' as target: {matched.failure}")
            found += matched.result
            for _ in matched.result:
                on_step()
    order = {(source.name, target.name): i for i, (source, target) in enumerate(pairs)}
    found.sort(key=lambda errors: order[errors.source, errors.target])
    return _summary(found, time.perf_counter() - start), tuple(found)


def randomly_rotated(shape: Shape, *, seed: int) -> Shape:
    """The shape rotated about the origin, uniformly at random by the seed and the shape's name."""
    return replace(shape, mesh=partial(_rotated, shape.mesh, shape.name, seed))


def _rotated(mesh: Callable[[], Mesh], name: str, seed: int) -> Mesh:
    original = mesh()
    generator = np.random.default_rng((seed, zlib.crc32(name.encode())))
    quaternion = generator.standard_normal(4)  # its direction is uniform, and so the rotation
    rotation = Rotation.from_quat(quaternion).as_matrix()
    return replace(original, vertices=original.vertices @ rotation.T)


def _save(
    job: tuple[Shape, _Saved], *, model: Model, refine: bool | None, cache: Cache | None
) -> None:
    """Compute what `_load` reads."""
    shape, place = job
    mesh = shape.mesh()
    truths = correspondences(shape, len(mesh.vertices))
    features = working_features(prepared(mesh), model=model, refine=refine, cache=cache)
    measured = repair(mesh, all_pieces=True)
    assert isinstance(measured.shape, Mesh)
    save_features(features, place.folder)
    np.savez(
        place.folder / "measured.npz",
        vertices=measured.shape.vertices,
        faces=measured.shape.faces,
        vertex_index=measured.vertex_index,
        points=truths[0],
        symmetric=truths[1] if len(truths) > 1 else np.zeros(0, dtype=np.int64),
    )


def _load(place: _Saved) -> _EvaluatedShape:
    with np.load(place.folder / "measured.npz", allow_pickle=False) as measured:
        index, points, symmetric = (
            measured[name] for name in ("vertex_index", "points", "symmetric")
        )
        truth = Truth(
            Mesh(measured["vertices"], measured["faces"]),
            _followed(points, index),
            _followed(symmetric, index) if len(symmetric) else None,
        )
    return _EvaluatedShape(load_features(place.folder), points, truth, index)


def _followed(index: IntArray, next_index: IntArray) -> IntArray:
    """Where vertices, -1 for none, go by a map."""
    return np.where(index >= 0, next_index[index], -1)


def _errors_on_target(
    job: tuple[_Saved, list[_Saved]],
    *,
    model: Model,
    refine: bool | None,
    candidates: Sequence[str] | None,
    threshold: float,
    cache: Cache | None,
) -> list[PairErrors]:
    """Errors of the maps from several sources to one target."""
    target, sources = _load(job[0]), [_load(place) for place in job[1]]
    maps = [
        match_features(
            source.features,
            target.features,
            model=model,
            refine=refine,
            candidates=candidates,
            cache=cache,
        ).rejecting(threshold)
        for source in sources
    ]
    # point of the template -> source vertex -> target vertex -> vertex that is measured
    predicted = [
        _followed(_followed(source.points, found.target_index), target.measured_index)
        for source, found in zip(sources, maps, strict=True)
    ]
    errors = errors_on_target(target.truth, np.stack(predicted))
    results = []
    for i, (source, found) in enumerate(zip(sources, maps, strict=True)):
        shared = (source.points >= 0) & (target.truth.index >= 0)
        lone = source.points[(source.points >= 0) & (target.points < 0)]
        judged = found.judgement
        results.append(
            PairErrors(
                source=job[1][i].name,
                target=job[0].name,
                errors=errors.direct[i, shared],
                symmetric_errors=(
                    None if target.truth.symmetric is None else errors.nearer[i, shared]
                ),
                confidence=found.confidence[source.points[shared]],
                square_root_area=surface_area(target.truth.mesh) ** 0.5,
                diameter=errors.diameter,
                coverage=found.coverage(len(target.measured_index)),
                lone_confidence=found.confidence[lone],
                lone_matched=found.target_index[lone] >= 0,
                verdict=judged.verdict if judged else None,
                expected_accuracy=judged.expected_accuracy if judged else None,
            )
        )
    return results


def _summary(found: Sequence[PairErrors], seconds: float) -> Evaluation:
    scaled = [pair.errors / pair.square_root_area for pair in found]
    matched = [error[np.isfinite(error)] for error in scaled]
    matched = [error for error in matched if len(error)]
    if not matched:
        raise InputError("No vertex was matched: every match lies beyond the threshold.")
    symmetric = [
        float(np.nanmean(pair.symmetric_errors / pair.square_root_area))
        for pair in found
        if pair.symmetric_errors is not None and np.isfinite(pair.symmetric_errors).any()
    ]
    means = [float(error.mean()) for error in matched]
    is_partial = any(len(pair.lone_matched) for pair in found)
    bins = confidence_bins(found)
    return Evaluation(
        mean_geodesic_error_x100=100 * float(np.mean(means)),
        median_geodesic_error_x100=100 * float(np.mean([np.median(e) for e in matched])),
        symmetric_mean_geodesic_error_x100=(
            100 * float(np.mean(symmetric)) if len(symmetric) == len(matched) else None
        ),
        accuracy_5pct_diameter=float(np.mean([pair.right().mean() for pair in found])),
        auc=float(np.mean([area_under_curve(error) for error in scaled])),
        coverage=float(np.mean([pair.coverage for pair in found])),
        worst_pair_x100=100 * max(means),
        matched=float(np.mean([np.isfinite(error).mean() for error in scaled])),
        overlap_iou=_mean([pair.overlap_iou() for pair in found]) if is_partial else None,
        overlap_balanced_accuracy=_mean([pair.overlap_balanced_accuracy() for pair in found]),
        confidence_separation=_mean([pair.confidence_separation() for pair in found]),
        calibration_error=sum(b.share * abs(b.confidence - b.right) for b in bins),
        pairs=len(found),
        seconds=seconds,
        verdicts=verdict_counts(found),
        confidence_bins=bins,
    )


def _mean(values: Sequence[float | None]) -> float | None:
    """Of those that are known; None where none is."""
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known else None


def separation(with_one: FloatArray, without: FloatArray) -> float | None:
    """Probability that one of the first values is larger than one of the second; ties count half.

    The area under the curve of true over false positives; None where there are none of a kind.
    """
    if not len(with_one) or not len(without):
        return None
    ranks = rankdata(np.concatenate([with_one, without]))[: len(with_one)].sum()
    below = len(with_one) * (len(with_one) + 1) / 2
    return float((ranks - below) / (len(with_one) * len(without)))


def confidence_bins(found: Sequence[PairErrors]) -> tuple[ConfidenceBin, ...]:
    """The reliability diagram of the confidence: bins that have matches."""
    confidence = np.concatenate([c for p in found for c in (p.confidence, p.lone_confidence)])
    right = np.concatenate(
        [part for p in found for part in (p.right(), np.zeros(len(p.lone_matched), dtype=bool))]
    )
    bins = []
    for low, high in pairwise(_BINS):
        some = (confidence >= low) & (confidence <= high if high == 1 else confidence < high)
        if some.any():
            means = (float(values.mean()) for values in (some, confidence[some], right[some]))
            bins.append(ConfidenceBin(low, high, *means))
    return tuple(bins)


def verdict_counts(found: Sequence[PairErrors]) -> dict[str, VerdictCount]:
    """What the maps with each verdict are like; those that were not judged are left out."""
    counts = {}
    for verdict in sorted({pair.verdict for pair in found if pair.verdict}):
        some = [pair for pair in found if pair.verdict == verdict]
        right = [float(pair.right().mean()) for pair in some]
        expected = [pair.expected_accuracy for pair in some if pair.expected_accuracy is not None]
        counts[verdict] = VerdictCount(
            len(some), float(np.mean(expected)), float(np.mean(right)), min(right)
        )
    return counts
