"""Maps between the shapes of a collection before anything is learned of it.

They are by the descriptors alone, or by a model of other classes. Such a map is right for some
pairs and wrong for others. The judge says which: chains of those maps that it trusts connect nearly
all shapes of a class.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from esd.common import FloatArray, IntArray
from esd.datasets.collection import Collection, Shape, repaired_shape
from esd.descriptors.recipe import Recipe
from esd.learning.model import Model
from esd.learning.samples import Samples
from esd.learning.teacher import FirstMaps
from esd.matching.batch import load_features, save_features
from esd.matching.candidates import (
    Candidate,
    pair_descriptors,
    sampled,
    spectral_candidate,
)
from esd.matching.collection import Pair, trusted_chains
from esd.matching.features import shape_features
from esd.matching.judge import accuracy, cost, evidence
from esd.nearest import nearest
from esd.parallel import THIS_PROCESS, Workers, outcomes, shared_folder
from esd.spectral.cache import Cache

_PAIRS, _PAIRS_OF_A_SHAPE = 200, 5  # the larger number at most, of all that there are
_NEAR_SHARE = 0.7  # of the pairs that are of shapes with similar spectra
_EIGENVALUES = 30  # by which spectra are compared
_TRUSTED = 0.5  # least expected accuracy of a map that is part of a chain
_GOOD = 0.75  # the same of maps between shapes that are near each other
_MOSTLY = 0.5  # share of the trusted maps beyond which the training starts from the model


@dataclass(frozen=True, slots=True, eq=False)
class _MappedPair:
    """Rows of either sample for those of the other, the expected accuracy both ways, by what."""

    forth: IntArray
    back: IntArray
    accuracy: tuple[float, float]
    by_model: bool


def first_maps(
    samples: Sequence[Samples],
    collection: Collection,
    recipe: Recipe,
    *,
    start: Model | None = None,
    seed: int = 0,
    workers: Workers = THIS_PROCESS,
    cache: Cache | None = None,
    on_step: Callable[[], None] = lambda: None,
) -> FirstMaps:
    """Maps between samples, and the chains of those that can be trusted.

    Parameters
    ----------
    samples
        Of shapes of the collection.
    recipe
        Of the descriptors.
    start
        A model of that recipe, whose embeddings are tried beside the descriptors; the training
        starts from it if most of the trusted maps are by it.
    seed
        Of the pairs that are mapped, where these are not all.
    workers
        What computes.
    cache
        Where spectra are looked up and kept.
    on_step
        Called after each shape and after each pair, `step_count` times.
    """
    maps: dict[Pair, IntArray] = {}
    trusted: dict[Pair, float] = {}
    by_model: list[bool] = []
    raw = Model("descriptors", recipe, np.zeros(recipe.width), np.ones(recipe.width))
    with shared_folder(workers) as folder:
        save = partial(_save, folder=folder, model=start or raw, cache=cache)
        jobs = [(i, collection[each.name], each.vertices) for i, each in enumerate(samples)]
        eigenvalues = np.ones((len(jobs), _EIGENVALUES))
        for saved in outcomes(save, jobs, workers=workers):
            on_step()
            if saved.result is not None:
                eigenvalues[saved.job[0]] = saved.result
        pairs = _pairs(eigenvalues, seed)
        names = ("descriptors",) if start is None else ("embedding", "descriptors")
        mapped = partial(_mapped, folder=folder, names=names)
        for outcome in outcomes(mapped, pairs, workers=workers):
            on_step()
            found, (i, j) = outcome.result, outcome.job
            if found is None:  # a shape that cannot be mapped has no chains
                continue
            for pair, rows, value in zip(
                ((i, j), (j, i)), (found.forth, found.back), found.accuracy, strict=True
            ):
                if value >= _TRUSTED:
                    maps[pair], trusted[pair] = rows, value
                    by_model.append(found.by_model)
    near = [
        (i, j) for i, j in pairs if min(trusted.get((i, j), 0.0), trusted.get((j, i), 0.0)) >= _GOOD
    ]
    starts = start if np.mean(by_model or [False]) > _MOSTLY else None
    return FirstMaps(maps, trusted_chains(trusted, len(samples)), near, starts)


def step_count(shapes: int) -> int:
    """Number of steps of `first_maps` for some shapes."""
    return shapes + _pair_count(shapes)


def _pair_count(shapes: int) -> int:
    return min(shapes * (shapes - 1) // 2, max(_PAIRS, _PAIRS_OF_A_SHAPE * shapes))


def _pairs(eigenvalues: FloatArray, seed: int) -> list[Pair]:
    """Pairs of shapes that are mapped: those of similar spectra, and some drawn at random.

    Shapes with similar spectra are similar, and maps between them good; the others connect classes
    of such shapes.

    Parameters
    ----------
    eigenvalues : (count, k)
        Positive ones of each shape, of unit area.
    """
    count = len(eigenvalues)
    logarithms = np.log(eigenvalues)
    apart = np.abs(logarithms[:, None] - logarithms).mean(axis=2)
    np.fill_diagonal(apart, -1.0)  # each shape is nearest to itself
    nearest_first = np.argsort(apart, axis=1, kind="stable").tolist()
    order = np.random.default_rng(seed).permutation(count).tolist()
    wanted = _pair_count(count)
    found: dict[Pair, None] = {}  # in the order in which they are found
    near = [(i, nearest_first[i][rank]) for rank in range(1, count) for i in range(count)]
    # with the one that comes so many places later, around the end: the first round is a ring
    ring = [(order[i], order[(i + r) % count]) for r in range(1, count) for i in range(count)]
    for listed, limit in ((near, _NEAR_SHARE * wanted), (ring, wanted)):
        for i, j in listed:
            if len(found) < limit:
                found[min(i, j), max(i, j)] = None
    return list(found)


def _save(
    job: tuple[int, Shape, IntArray], *, folder: Path, model: Model, cache: Cache | None
) -> FloatArray:
    """The eigenvalues of a shape; its features and sampled vertices are written."""
    number, shape, vertices = job
    features = shape_features(repaired_shape(shape)[0], model=model, cache=cache)
    save_features(features, folder / str(number))
    np.save(folder / f"{number}-vertices.npy", vertices)
    spectrum = features.spectrum.with_area(1.0)
    return spectrum.eigenvalues[spectrum.zero_modes :][:_EIGENVALUES]


def _mapped(pair: Pair, *, folder: Path, names: Sequence[str]) -> _MappedPair:
    """The best map between two shapes at their samples, of those named, and what it is worth."""
    source, target = (sampled(load_features(folder / str(number))) for number in pair)
    descriptors = pair_descriptors(source, target)
    embeddings = source.features.embedded, target.features.embedded
    rows = {"embedding": embeddings, "descriptors": descriptors.rows()}
    tried = [spectral_candidate(name, source, target, rows[name]) for name in names]
    judged = [(each, evidence(source, target, each, descriptors)) for each in tried]
    best, its_evidence = min(judged, key=lambda each: cost(each[1]))
    forward, backward = best.forward, best.backward
    turned = Candidate(best.name, backward[::-1], forward[::-1], None)
    accuracies = (
        accuracy(its_evidence),
        accuracy(evidence(target, source, turned, descriptors.reversed())),
    )
    here, there = (np.load(folder / f"{number}-vertices.npy") for number in pair)
    forth, _ = nearest(forward[0][here], forward[1][there])
    back, _ = nearest(backward[1][there], backward[0][here])
    return _MappedPair(forth, back, accuracies, best.name == "embedding")
