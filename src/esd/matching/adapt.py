"""A model adapted to the two shapes at hand, where a judge finds its map better."""

from __future__ import annotations

import time
from collections.abc import Sequence
from importlib.util import find_spec

import numpy as np

from esd.common import InputError, IntArray
from esd.datasets.deformation import deformed
from esd.descriptors.recipe import recipe_spectrum, spectrum_descriptors
from esd.learning.model import Model, standardised
from esd.learning.samples import Samples, closeness
from esd.learning.teacher import Lesson, sifted
from esd.matching.candidates import Candidate, pair_descriptors, sampled
from esd.matching.choice import chosen
from esd.matching.confidence import Adaptation
from esd.matching.features import Features
from esd.matching.judge import cost, evidence
from esd.mesh.geodesics import geodesic_graph
from esd.mesh.geometry import surface_area, vertex_areas, vertex_normals
from esd.mesh.mesh import Mesh
from esd.nearest import nearest
from esd.spectral.cache import Cache

_POINTS = 4000  # of either shape, from which matches are drawn
_EIGENFUNCTIONS = 100
_COPIES = 1  # deformed copies of either shape


def check_adaptation(model: Model) -> None:
    """Raise an `InputError` unless torch is there and the model can be adapted."""
    if find_spec("torch") is None:
        raise InputError(
            "Adapting needs torch: pip install 'embedded-spectral-descriptors[train]', or leave "
            "--adapt (adapt=True) out."
        )
    from esd.learning.updates import network_of

    network_of(model)


def adapted_model(
    source: Features,
    target: Features,
    *,
    model: Model,
    names: Sequence[str] | None = None,
    landmarks: IntArray | None = None,
    seed: int = 0,
    cache: Cache | None = None,
) -> tuple[Model, Adaptation]:
    """A model adapted to a source and a target if that is better, else the model itself.

    It learns from the best of several candidates, then from its own maps, see
    `esd.learning.adapt`.

    Parameters
    ----------
    names, landmarks
        See `esd.matching.choice.chosen`.
    seed
        Of all that is random.
    cache
        Where spectra of deformed copies are looked up and kept.

    Raises
    ------
    InputError
        If torch is missing, the shapes have no faces, or the model cannot be adapted.
    """
    if not (isinstance(source.shape, Mesh) and isinstance(target.shape, Mesh)):
        raise InputError("Adapting needs meshes; these are points.")
    check_adaptation(model)
    from esd.learning.adapt import adapted

    start = time.perf_counter()
    before = chosen(source, target, names=names, landmarks=landmarks)
    marks = np.zeros((0, 2), dtype=np.int64)
    if landmarks is not None:
        marks = np.delete(landmarks, before.contradicted, axis=0)
    samples = [
        _samples(each, marks[:, i], model=model, seed=seed + i, cache=cache)
        for i, each in enumerate((source, target))
    ]
    first = _lesson(before.candidate, samples[0], samples[1])
    other = adapted(model, samples[0], samples[1], first=first, seed=seed)
    pairs = [(source, target), (source.embedded_by(other), target.embedded_by(other))]
    after = chosen(*pairs[1], names=names, landmarks=landmarks)
    costs = [_mean_cost(each.candidate, pairs) for each in (before, after)]
    is_kept = costs[1] < costs[0]
    found = Adaptation(time.perf_counter() - start, costs[0], costs[1], is_kept)
    return (other if is_kept else model), found


def _samples(
    features: Features, marks: IntArray, *, model: Model, seed: int, cache: Cache | None
) -> Samples:
    """Samples by area of a mesh and of its deformed copies, without what fills holes.

    First come the landmarks, vertices (l,), by the order of which they are named.
    """
    mesh = features.shape
    assert isinstance(mesh, Mesh)
    area = vertex_areas(mesh)
    if features.copy is None:
        area[features.is_filling()] = 0.0
    count = min(_POINTS, int(np.count_nonzero(area)))
    generator = np.random.default_rng(seed)
    drawn = generator.choice(len(area), size=count, replace=False, p=area / area.sum())
    vertices = np.concatenate([marks, np.setdiff1d(drawn, marks)])
    described = [features.values]
    for copy in range(_COPIES):
        other = deformed(mesh, seed=seed + copy)
        spectrum = recipe_spectrum(model.recipe, other, cache=cache)
        described.append(spectrum_descriptors(model.recipe, other, spectrum).astype(np.float32))
    values = tuple(
        np.nan_to_num(
            standardised(each[vertices], model.mean, model.deviation, limit=model.limit)
        ).astype(np.float32)
        for each in described
    )
    scale = np.sqrt(surface_area(mesh))
    known = {str(i): i for i in range(len(marks))}
    distances = geodesic_graph(mesh).distances(marks)[:, vertices] / scale if known else ()
    spectrum = features.spectrum.with_area(1.0)
    return Samples(
        name="",
        values=values,
        eigenvectors=spectrum.eigenvectors[vertices, :_EIGENFUNCTIONS].astype(np.float32),
        positions=(mesh.vertices[vertices] / scale).astype(np.float32),
        normals=vertex_normals(mesh)[vertices].astype(np.float32),
        vertices=vertices,
        known=known,
        closeness=dict(zip(known, map(closeness, distances), strict=True)),
    )


def _lesson(candidate: Candidate, source: Samples, target: Samples) -> Lesson:
    """The reliable matches between samples of a candidate's map."""
    here, there = source.vertices, target.vertices
    forth, _ = nearest(candidate.forward[0][here], candidate.forward[1][there])
    back, _ = nearest(candidate.backward[1][there], candidate.backward[0][here])
    rows = np.arange(len(here)), np.arange(len(there))
    return sifted(source, target, rows, forth, back)


def _mean_cost(candidate: Candidate, pairs: Sequence[tuple[Features, Features]]) -> float:
    """The cost of a candidate by each of several embeddings, averaged."""
    costs = []
    for pair in pairs:
        shapes = [sampled(each) for each in pair]
        descriptors = pair_descriptors(shapes[0], shapes[1])
        costs.append(cost(evidence(shapes[0], shapes[1], candidate, descriptors)))
    return float(np.mean(costs))
