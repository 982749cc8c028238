"""Evaluation of a model over pairs of shapes with known correspondence."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from esd.common import FloatArray, InputError, IntArray
from esd.datasets.collection import Shape, mended
from esd.evaluation.errors import area_under_curve, geodesic_errors
from esd.learning.model import Model
from esd.matching.batch import load_features, save_features
from esd.matching.features import Features, shape_features
from esd.matching.match import match_repaired
from esd.mesh.geodesics import geodesic_diameter, geodesic_graph
from esd.mesh.geometry import surface_area
from esd.mesh.mesh import Mesh
from esd.mesh.repair.repair import RESTORED, repair
from esd.parallel import THIS_PROCESS, Workers, outcomes, shared_folder
from esd.spectral.cache import Cache


@dataclass(frozen=True, slots=True, eq=False)
class PairErrors:
    """Errors of one map at the points of the template that both shapes have.

    Parameters
    ----------
    source, target
        Names of the shapes.
    errors, symmetric_errors : (p,)
        Geodesic distance to the true vertex, and to the nearer of the true and the mirrored one,
        in units of length; NaN where the map has no match. The second is None where no mirrored
        truth is known.
    square_root_area, diameter
        Of the target, in units of length.
    coverage
        Share of the target's vertices that some source vertex is mapped to.
    """

    source: str
    target: str
    errors: FloatArray
    symmetric_errors: FloatArray | None
    square_root_area: float
    diameter: float
    coverage: float


@dataclass(frozen=True, slots=True)
class Evaluation:
    """Figures over all pairs: means over pairs of the figures of each.

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
        Share of the points that have a match.
    pairs
        Number of pairs.
    seconds
        Wall time.
    """

    mean_geodesic_error_x100: float
    median_geodesic_error_x100: float
    symmetric_mean_geodesic_error_x100: float | None
    accuracy_5pct_diameter: float
    auc: float
    coverage: float
    worst_pair_x100: float
    matched: float
    pairs: int
    seconds: float


@dataclass(frozen=True, slots=True)
class _Kept:
    """The name of a shape, and the folder where what is computed of it is kept."""

    name: str
    folder: Path


@dataclass(frozen=True, slots=True, eq=False)
class _Embedded:
    """A shape as it is matched, and as it is measured.

    Parameters
    ----------
    mesh
        On which errors are measured: repaired, but neither filled nor smoothed.
    features
        Of the same filled and smoothed, r vertices, see `esd.mesh.repair.repair`.
    represented : (r,)
        The vertex of `mesh` that each represents: itself, or one on the rim of the hole it fills.
    index, symmetric
        Vertices at the points of the template.
    """

    mesh: Mesh
    features: Features
    represented: IntArray
    index: IntArray
    symmetric: IntArray | None


def evaluate(
    model: Model,
    pairs: Sequence[tuple[Shape, Shape]],
    *,
    refine: bool | None = None,
    candidates: Sequence[str] | None = None,
    reject: bool = False,
    workers: Workers = THIS_PROCESS,
    cache: Cache | None = None,
    on_step: Callable[[], None] = lambda: None,
) -> tuple[Evaluation, tuple[PairErrors, ...]]:
    """Figures of a model over pairs of shapes, and the errors of each pair, in their order.

    First each shape is described, once, and kept on disk meanwhile; then the pairs are matched.

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
    refine = model.is_oriented if refine is None else refine
    start = time.perf_counter()
    shapes = {shape.name: shape for pair in pairs for shape in pair}
    for shape in (shape for pair in pairs for shape in pair):
        if shape is not shapes[shape.name]:
            raise InputError(f"Two different shapes are called '{shape.name}'; rename one.")
    found: list[PairErrors] = []
    with shared_folder(workers) as folder:
        places = {name: _Kept(name, folder / str(i)) for i, name in enumerate(shapes)}
        first = partial(_embed, model=model, cache=cache)
        jobs = ((shape, places[name]) for name, shape in shapes.items())
        for described in outcomes(first, jobs, workers=workers):
            if described.failure:
                raise InputError(described.failure_of(described.job[0].name))
            on_step()
        sources: dict[str, list[_Kept]] = {}
        for source, target in pairs:
            sources.setdefault(target.name, []).append(places[source.name])
        work = partial(
            _errors_on_target,
            model=model,
            refine=refine,
            candidates=candidates,
            threshold=threshold,
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


def _embed(job: tuple[Shape, _Kept], *, model: Model, cache: Cache | None) -> None:
    """Compute what `_embedded` reads."""
    shape, place = job
    repaired, index, symmetric = mended(shape)
    described = shape_features(repaired, model=model, cache=cache)
    mesh, represented = repaired.shape, np.arange(len(repaired.original_index))
    if repaired.done & RESTORED:
        mesh = repair(shape.mesh(), all_pieces=True).shape
        fill = slice(len(mesh.vertices), None)
        represented[fill] = repaired.vertex_index[repaired.original_index[fill]]
    assert isinstance(mesh, Mesh)
    save_features(described, place.folder)
    np.savez(
        place.folder / "measured.npz",
        vertices=mesh.vertices,
        faces=mesh.faces,
        represented=represented,
        index=index,
        symmetric=np.zeros(0) if symmetric is None else symmetric,
    )


def _embedded(place: _Kept) -> _Embedded:
    with np.load(place.folder / "measured.npz", allow_pickle=False) as measured:
        return _Embedded(
            Mesh(measured["vertices"], measured["faces"]),
            load_features(place.folder),
            measured["represented"],
            measured["index"],
            measured["symmetric"] if len(measured["symmetric"]) else None,
        )


def _errors_on_target(
    job: tuple[_Kept, list[_Kept]],
    *,
    model: Model,
    refine: bool,
    candidates: Sequence[str] | None,
    threshold: float,
) -> list[PairErrors]:
    """Errors of the maps from several sources to one target."""
    target, sources = _embedded(job[0]), [_embedded(place) for place in job[1]]
    graph = geodesic_graph(target.mesh)
    diameter = geodesic_diameter(target.mesh, graph=graph)
    maps = []
    for source in sources:
        match = match_repaired(
            source.features, target.features, model=model, refine=refine, candidates=candidates
        )
        matched = match.rejecting(threshold).target_index
        # of the vertices of the source as it is measured, which come before those of fillings
        vertices = matched[: len(source.mesh.vertices)]
        maps.append(np.where(vertices >= 0, target.represented[vertices], -1))
    # all maps at once, so that each target vertex is the source of distances only once
    predicted = [
        np.where(source.index >= 0, index[source.index], -1)
        for source, index in zip(sources, maps, strict=True)
    ]
    truths = [target.index] if target.symmetric is None else [target.index, target.symmetric]
    stacked = tuple(np.tile(truth, len(sources)) for truth in truths)
    errors = [
        np.minimum(error, diameter).reshape(len(sources), -1)  # another component: infinitely far
        for error in geodesic_errors(graph, np.concatenate(predicted), stacked)
    ]
    shared = [(source.index >= 0) & (target.index >= 0) for source in sources]
    nearer = errors[0] if len(errors) == 1 else np.fmin(*errors)
    return [
        PairErrors(
            source=job[1][i].name,
            target=job[0].name,
            errors=errors[0][i, shared[i]],
            symmetric_errors=None if target.symmetric is None else nearer[i, shared[i]],
            square_root_area=surface_area(target.mesh) ** 0.5,
            diameter=diameter,
            coverage=len(np.unique(maps[i][maps[i] >= 0])) / len(target.mesh.vertices),
        )
        for i in range(len(sources))
    ]


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
    within = [float((pair.errors <= 0.05 * pair.diameter).mean()) for pair in found]
    return Evaluation(
        mean_geodesic_error_x100=100 * float(np.mean(means)),
        median_geodesic_error_x100=100 * float(np.mean([np.median(e) for e in matched])),
        symmetric_mean_geodesic_error_x100=(
            100 * float(np.mean(symmetric)) if len(symmetric) == len(matched) else None
        ),
        accuracy_5pct_diameter=float(np.mean(within)),
        auc=float(np.mean([area_under_curve(error) for error in scaled])),
        coverage=float(np.mean([pair.coverage for pair in found])),
        worst_pair_x100=100 * max(means),
        matched=float(np.mean([np.isfinite(error).mean() for error in scaled])),
        pairs=len(found),
        seconds=seconds,
    )
