"""Learning without correspondences: from unregistered meshes of one class, in minutes.

The network teaches itself: see `esd.learning.teacher`. Beside its own maps, whatever is known is
used: deformed copies of each shape, landmarks, and correspondences of some of the shapes.
"""

from __future__ import annotations

import logging
import math
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from scipy import sparse
from scipy.sparse import csgraph

from esd.common import FloatArray, InputError
from esd.datasets.collection import Collection
from esd.learning.model import Model, standardised
from esd.learning.network import seeded_network
from esd.learning.optimise import (
    adam_with_moments,
    descend,
    load_checkpoint,
    save_checkpoint,
)
from esd.learning.presets import Training
from esd.learning.samples import Samples, collection_samples, moments
from esd.learning.teacher import FIRST_SIZES, FirstMaps, Lesson, is_reliable, lesson
from esd.learning.updates import Matches, embedding_by, infonce_of_matches, layers_of, network_of
from esd.parallel import THIS_PROCESS, Workers
from esd.spectral.cache import Cache, content_key

_log = logging.getLogger(__name__)

_LARGEST_SEED = 2**32 - 1
_FEWEST_SHAPES, _FEW_SHAPES = 2, 6
_LARGEST_MEMORY = 2**31  # bytes of descriptors
_FEWEST_POINTS = 1000  # of each shape
_LAST_RATE = 0.05  # of the learning rate, at the end of its cosine
_TRIES = 5  # pairs tried in a step until one teaches something
_PARTNERS = 6  # with which each shape is matched in the end, to see whether it found its place
_USUAL = 0.8  # quantile of the shares of reliable matches that counts as usual
_BELONGING = 0.7  # of the usual share of reliable matches, above which two shapes are of one class


@dataclass(frozen=True, slots=True)
class Teaching:
    """How an embedding is learned without correspondences.

    Parameters
    ----------
    steps
        Pairs of shapes that are matched, the warm-up included.
    warm_up
        Steps at the beginning, no more than a third of all, in which the network learns from maps
        that are known before, or else from copies of each shape, so that its first own maps start
        from more than a random network.
    updates
        Steps of the optimiser for each: on the last matches, then on such of `recent` pairs.
    own_share
        Share of the other updates that are between copies of one shape instead, whose truth is
        known.
    near_share
        Share of the pairs after the warm-up that are drawn from those whose first maps are good;
        the others from all that are of one class.
    recent
        Number of pairs whose matches are remembered.
    points
        Points of each shape that are kept; fewer of very many shapes.
    drawn
        Points of either shape of a pair that are matched.
    batch
        Matches in an update.
    copies
        Smoothly deformed copies of each shape, which are trained on as well.
    eigenfunctions
        Number with which the refinement of a map ends, in the last step.
    learning_rate
        Of Adam, in the first step; it falls as a cosine.
    validate_every
        Steps between two points of the curve, and between two checkpoints.
    """

    steps: int = 1000
    warm_up: int = 100
    updates: int = 5
    own_share: float = 0.2
    near_share: float = 0.75
    recent: int = 12
    points: int = 4000
    drawn: int = 1500
    batch: int = 400
    copies: int = 2
    eigenfunctions: int = 100
    learning_rate: float = 1e-3
    validate_every: int = 50


@dataclass(frozen=True, slots=True)
class TeachingProgress:
    """Progress of a training without correspondences.

    Parameters
    ----------
    step, steps
        Steps done, and to be done.
    loss
        Mean since the last point of the curve; None if no pair taught anything.
    returning, oriented
        Mean shares of the tried points that return, and that keep their orientation, over the
        pairs since then; None during the warm-up. A training can fail with both high, but does not
        succeed with them low.
    validation
        Mean share that does both between shapes that are held out and those trained on, or None.
    """

    step: int
    steps: int
    loss: float | None
    returning: float | None
    oriented: float | None
    validation: float | None = None


@dataclass(slots=True, eq=False)
class _Run:
    """All that changes during a training, and that a checkpoint keeps."""

    network: torch.nn.Sequential
    optimiser: torch.optim.Adam
    step: int = 0
    curve: list[TeachingProgress] = field(default_factory=list)


def train_unsupervised(
    collection: Collection,
    training: Training,
    *,
    teaching: Teaching | None = None,
    name: str = "model",
    seed: int = 0,
    validation: Collection | None = None,
    start: Model | None = None,
    first_maps: Callable[[tuple[Samples, ...]], FirstMaps] | None = None,
    checkpoint: str | os.PathLike[str] | None = None,
    workers: Workers = THIS_PROCESS,
    cache: Cache | None = None,
    on_shape: Callable[[], None] = lambda: None,
    on_progress: Callable[[TeachingProgress], None] = lambda _: None,
) -> Model:
    """The embedding learned from shapes of one class, whose correspondences need not be known.

    Correspondences of shapes of one template, and landmarks, are used where there are some. Equal
    arguments and equal numbers of threads give equal weights, also when the training was
    interrupted and resumed from its checkpoint. The model's card lists under `groups` the shapes
    that came to match each other, the largest group first: of one class there is one, and a shape
    that found no place is a group of its own. Under `left_out` are those that could not be
    described, with the reason.

    Parameters
    ----------
    collection
        Of meshes of any connectivity.
    training
        Whose recipe and network are used; its loss must be `infonce`.
    validation
        Shapes that are not trained on. Nothing depends on them but the curve.
    start
        A model of the same recipe and layers from whose weights the training starts. A network
        that it has beside its layers stays as it is.
    first_maps
        Gives maps between the samples, from which the network learns during the warm-up; see
        `esd.matching.first_maps`. Without, it learns from copies of each shape alone meanwhile.
    checkpoint
        A file from which an interrupted training resumes, and which is removed at its end.
    workers
        What computes the features of shapes.
    cache
        Where spectra are looked up and kept.
    on_shape, on_progress
        Called after each shape is described, and at each point of the curve.

    Raises
    ------
    InputError
        If the training or the start does not fit, the shapes that can be described are fewer than
        two or too many, or the checkpoint belongs to another training.

    References
    ----------
    Cao, Roetzer, Bernard 2023, *Unsupervised learning of robust spectral shape matching*, for the
    task; InfoNCE as in `esd.learning.losses`.
    """
    teaching = teaching or Teaching()
    if training.loss != "infonce" or training.patches is not None:
        raise InputError(
            "Learning without correspondences takes presets with loss 'infonce', such as "
            f"'oriented'; this one has '{training.loss}'. Add correspondences, or change it."
        )
    if not 0 <= seed <= _LARGEST_SEED:
        raise InputError(f"`seed` must be from 0 to {_LARGEST_SEED}; got {seed}.")
    if start is not None:
        _check_start(start, training)
    teaching = _within_memory(teaching, training, len(collection.shapes))
    describe = partial(
        collection_samples,
        recipe=training.recipe,
        points=teaching.points,
        eigenfunctions=teaching.eigenfunctions,
        workers=workers,
        cache=cache,
        on_shape=on_shape,
    )
    _check_count(len(collection.shapes), {})
    described = describe(collection, copies=teaching.copies, seed=seed)
    samples, doubles = _without_doubles(described.samples)
    left_out = {**described.failures, **doubles}
    _check_count(len(samples), left_out)
    if len(samples) < _FEW_SHAPES:
        _log.warning(
            "A model of %d shapes will hardly be good for others; from about ten on it is.",
            len(samples),
        )
    first = None if first_maps is None or start is not None else first_maps(samples)
    if first is not None and first.start is not None:
        start = first.start
    if first is None and not teaching.copies:
        teaching = replace(teaching, warm_up=0)  # there is nothing to learn from meanwhile
    mean, deviation = moments(samples) if start is None else (start.mean, start.deviation)
    held: tuple[Samples, ...] = ()
    if validation is not None:
        described = describe(validation, copies=0, seed=seed)
        held = described.samples
        left_out |= described.failures
    for each in (*samples, *held):
        _standardise(each, mean, deviation, limit=training.limit)

    run = _started(training, teaching, seed, start)
    path = Path(checkpoint) if checkpoint is not None else None
    identity = _identity(samples, held, training, teaching, seed, start)
    if path is not None and path.exists():
        state, _ = load_checkpoint(path, run.network, run.optimiser, identity=identity)
        run.curve = [TeachingProgress(**point) for point in state["curve"]]
        run.step = run.curve[-1].step
    while run.step < teaching.steps:
        _advance(run, samples, held, training, teaching, seed, first)
        if path is not None:
            save_checkpoint(
                path,
                run.network,
                run.optimiser,
                identity=identity,
                state={"curve": [asdict(point) for point in run.curve]},
                tensors={},
            )
        on_progress(run.curve[-1])
    if path is not None:
        path.unlink(missing_ok=True)
    card = {
        "data": collection.name,
        "shapes": [each.name for each in samples],
        "validation_shapes": [each.name for each in held],
        "left_out": left_out,
        "groups": [list(group) for group in _groups(run, samples, teaching, seed, first)],
        "known": [each.name for each in samples if each.known],
        "training": _settings(training),
        "teaching": asdict(teaching),
        "start": None if start is None else start.name,
        "seed": seed,
        "steps_done": run.step,
        "curve": [asdict(point) for point in run.curve],
        "threads": torch.get_num_threads(),
        "torch": str(torch.__version__),
    }
    return Model(
        name=name,
        recipe=training.recipe,
        mean=mean,
        deviation=deviation,
        layers=layers_of(run.network),
        limit=training.limit,
        unit_length=True,
        diffusion=None if start is None else start.diffusion,
        card=card,
    )


def _check_count(count: int, left_out: Mapping[str, str]) -> None:
    if count < _FEWEST_SHAPES:
        reasons = "".join(f" '{key}': {why}" for key, why in left_out.items())
        raise InputError(
            f"Learning without correspondences needs {_FEWEST_SHAPES} shapes or more, and is good "
            f"from about ten on; got {count} that can be used.{reasons}"
        )


def _without_doubles(
    samples: Sequence[Samples],
) -> tuple[tuple[Samples, ...], dict[str, str]]:
    """Samples of different meshes, and of which of these each other one is a double."""
    first: dict[str, Samples] = {}
    doubles = {}
    for each in samples:
        kept = first.setdefault(each.content, each)
        if kept is not each:
            doubles[each.name] = f"it is the same mesh as '{kept.name}'"
    return tuple(first.values()), doubles


def _settings(training: Training) -> dict[str, Any]:
    settings = asdict(training)
    del settings["recipe"]  # the model has it
    return settings


def can_start(start: Model, training: Training) -> bool:
    """Whether a training can start from a model: descriptors and layers are the same."""
    widths = [layer.weight.shape[0] for layer in start.layers]
    wanted = [*training.hidden, training.outputs]
    return start.recipe.to_json() == training.recipe.to_json() and widths == wanted


def _check_start(start: Model, training: Training) -> None:
    """Raise an `InputError` unless a training can start from a model."""
    if not can_start(start, training):
        widths = [layer.weight.shape[0] for layer in start.layers]
        wanted = [*training.hidden, training.outputs]
        raise InputError(
            f"The training cannot start from '{start.name}': its descriptors or its layers "
            f"({widths}) are not those of the preset ({wanted}). Start from a model of the same "
            "preset, or from none."
        )


def _within_memory(teaching: Teaching, training: Training, shapes: int) -> Teaching:
    """The same with fewer points a shape, or without copies, where all would take too much."""
    of_one_point = 4 * training.recipe.width * shapes  # bytes
    for copies in (teaching.copies, 0):
        points = int(_LARGEST_MEMORY / (of_one_point * (1 + copies)))
        if points >= min(_FEWEST_POINTS, teaching.points):
            return replace(teaching, points=min(teaching.points, points), copies=copies)
    raise InputError(
        f"{shapes} shapes are more than learning without correspondences can hold in memory; "
        f"choose {_LARGEST_MEMORY // (4 * training.recipe.width * _FEWEST_POINTS)} or fewer with "
        "`--include`."
    )


def _standardise(
    samples: Samples, mean: FloatArray, deviation: FloatArray, *, limit: float | None
) -> None:
    """Change descriptors to what the network takes; undefined ones to their mean.

    In place, because those of all shapes together fill much of the memory.
    """
    for part in samples.values:
        part[...] = np.nan_to_num(standardised(part, mean, deviation, limit=limit))


def _started(training: Training, teaching: Teaching, seed: int, start: Model | None) -> _Run:
    widths = [training.recipe.width, *training.hidden, training.outputs]
    network = seeded_network(widths, seed) if start is None else network_of(start)
    return _Run(network, adam_with_moments(network, rate=teaching.learning_rate))


def _advance(
    run: _Run,
    samples: Sequence[Samples],
    held: Sequence[Samples],
    training: Training,
    teaching: Teaching,
    seed: int,
    first: FirstMaps | None,
) -> None:
    """Train to the next point of the curve, or to the last step."""
    stop = min(run.step + teaching.validate_every, teaching.steps)
    recent: list[Matches] = []  # begun anew after each checkpoint, so that resuming is the same
    tried: list[Lesson] = []
    losses: list[float] = []
    for step in range(run.step, stop):
        share = _share(step, teaching)
        fall = (1 + math.cos(math.pi * share)) / 2
        rate = teaching.learning_rate * (_LAST_RATE + (1 - _LAST_RATE) * fall)
        generator = np.random.default_rng((seed, step))
        if step == _warm_up(teaching):
            recent.clear()
        if step < _warm_up(teaching):
            recent.append(_first_matches(samples, first, teaching, generator))
        else:
            recent += _reliable(run, samples, teaching, share, generator, tried, first)
        del recent[: -teaching.recent]
        if not recent:
            continue
        dropout = torch.Generator().manual_seed(_LARGEST_SEED * step + seed)
        for update in range(teaching.updates):
            matches = recent[-1]
            if update and generator.random() < teaching.own_share and teaching.copies:
                matches = _own_copies(samples, teaching, generator)
            elif update:
                matches = recent[generator.integers(len(recent))]
            loss = infonce_of_matches(
                run.network,
                matches,
                training,
                batch=teaching.batch,
                generator=generator,
                dropout=dropout,
            )
            descend(run.optimiser, loss, rate=rate)
            losses.append(float(loss.detach()))
    run.step = stop
    validation = None
    if held:
        validation = _validation(run, samples, held, teaching, seed)
    run.curve.append(
        TeachingProgress(
            step=run.step,
            steps=teaching.steps,
            loss=_mean(losses),
            returning=_mean([each.returning for each in tried]),
            oriented=_mean([each.oriented for each in tried]),
            validation=validation,
        )
    )


def _warm_up(teaching: Teaching) -> int:
    return min(teaching.warm_up, teaching.steps // 3)


def _share(step: int, teaching: Teaching) -> float:
    """Share of the training after the warm-up that is done, from 0 to 1."""
    start = _warm_up(teaching)
    return max(0, step - start) / (teaching.steps - start)


def _mean(values: Sequence[float]) -> float | None:
    return float(np.mean(values)) if values else None


def _first_matches(
    samples: Sequence[Samples],
    first: FirstMaps | None,
    teaching: Teaching,
    generator: np.random.Generator,
) -> Matches:
    """Matches by the first maps of a pair drawn at random, else between versions of one shape."""
    for _ in range(_TRIES if first is not None else 0):
        assert first is not None
        source, target = _drawn_pair(samples, first, generator)
        found = first.lesson(samples, source, target)
        if found is not None and is_reliable(found):
            return Matches(samples[source], samples[target], found)
    return _own_copies(samples, teaching, generator)


def _drawn_pair(
    samples: Sequence[Samples],
    first: FirstMaps | None,
    generator: np.random.Generator,
    *,
    near_share: float = 0.0,
) -> tuple[int, int]:
    """Numbers of two shapes drawn at random, of those that the first maps connect, if any.

    With some probability, of those that are near each other.
    """
    if first is not None:
        is_near = bool(first.near) and generator.random() < near_share
        pairs = first.near if is_near else first.pairs()
        if pairs:
            return pairs[int(generator.integers(len(pairs)))]
    source, target = generator.choice(len(samples), size=2, replace=False).tolist()
    return source, target


def _own_copies(
    samples: Sequence[Samples], teaching: Teaching, generator: np.random.Generator
) -> Matches:
    """Matches between versions of one shape, drawn at random."""
    shape = samples[int(generator.integers(len(samples)))]
    rows = generator.permutation(len(shape.positions))[: teaching.drawn]
    return Matches(shape, shape, Lesson(rows, rows, 1.0, 1.0, 1.0))


def _reliable(
    run: _Run,
    samples: Sequence[Samples],
    teaching: Teaching,
    share: float,
    generator: np.random.Generator,
    tried: list[Lesson],
    first: FirstMaps | None,
) -> list[Matches]:
    """Matches of a pair drawn at random that can be relied on, none if there is no such pair.

    All that were tried are added to a list.
    """
    for _ in range(_TRIES):
        source, target = _drawn_pair(samples, first, generator, near_share=teaching.near_share)
        found = _lesson(run, samples[source], samples[target], teaching, share, generator)
        tried.append(found)
        if is_reliable(found):
            return [Matches(samples[source], samples[target], found)]
    return []


def _sizes(last: int, share: float) -> list[int]:
    """Numbers of eigenfunctions of a refinement, of which more are used as the training goes on."""
    end = round(FIRST_SIZES[-1] + (last - FIRST_SIZES[-1]) * share)
    middle = [round(math.sqrt(FIRST_SIZES[-1] * end))] if end > 3 * FIRST_SIZES[-1] else []
    return [*FIRST_SIZES, *middle, max(end, FIRST_SIZES[-1])]


def _lesson(
    run: _Run,
    source: Samples,
    target: Samples,
    teaching: Teaching,
    share: float,
    generator: np.random.Generator,
) -> Lesson:
    """What the network, as it is, has to teach about a pair."""
    return lesson(
        source,
        target,
        embedding_by(run.network),
        sizes=_sizes(teaching.eigenfunctions, share),
        count=teaching.drawn,
        generator=generator,
    )


def _validation(
    run: _Run,
    samples: Sequence[Samples],
    held: Sequence[Samples],
    teaching: Teaching,
    seed: int,
) -> float:
    """Mean share of reliable matches between each shape held out and one that is trained on."""
    generator = np.random.default_rng((_LARGEST_SEED, seed))
    share = _share(run.step, teaching)
    partners = generator.integers(len(samples), size=len(held))
    kept = [
        _lesson(run, shape, samples[partner], teaching, share, generator).kept
        for shape, partner in zip(held, partners, strict=True)
    ]
    return float(np.mean(kept))


def _groups(
    run: _Run,
    samples: Sequence[Samples],
    teaching: Teaching,
    seed: int,
    first: FirstMaps | None,
) -> tuple[tuple[str, ...], ...]:
    """Names of the shapes that match each other, the largest group first.

    They are those that the first maps connect. Without first maps, each shape is matched with some
    others, the next ones in a random order, and two belong together if the share of reliable
    matches is not much less than it usually is.
    """
    count = len(samples)
    connected = first.pairs() if first is not None else []
    if connected:
        ends = np.array(connected).T
        return _named_groups(
            samples, sparse.coo_array((np.ones(ends.shape[1]), tuple(ends)), shape=(count, count))
        )
    generator = np.random.default_rng((_LARGEST_SEED, seed))
    order = generator.permutation(count)
    offsets = range(1, min(_PARTNERS, count // 2) + 1)
    pairs = {
        tuple(sorted((int(order[i]), int(order[(i + offset) % count]))))
        for i in range(count)
        for offset in offsets
    }
    i, j = np.array(sorted(pairs), dtype=np.int64).T
    kept = np.array(
        [
            _lesson(run, samples[a], samples[b], teaching, 1.0, generator).kept
            for a, b in zip(i.tolist(), j.tolist(), strict=True)
        ]
    )
    belong = kept >= _BELONGING * np.quantile(kept, _USUAL)
    graph = sparse.coo_array((belong, (i, j)), shape=(count, count))
    graph.eliminate_zeros()
    return _named_groups(samples, graph)


def _named_groups(
    samples: Sequence[Samples], graph: sparse.coo_array
) -> tuple[tuple[str, ...], ...]:
    """Names of the shapes that a graph connects, the largest group first."""
    _, label = csgraph.connected_components(graph, directed=False)
    groups = [
        tuple(samples[k].name for k in np.flatnonzero(label == g).tolist()) for g in set(label)
    ]
    return tuple(sorted(groups, key=lambda group: (-len(group), group)))


def _identity(
    samples: Sequence[Samples],
    held: Sequence[Samples],
    training: Training,
    teaching: Teaching,
    seed: int,
    start: Model | None,
) -> str:
    """What a training depends on; a checkpoint is resumed only by the same."""
    arrays = [array for each in (*samples, *held) for array in (*each.values, each.eigenvectors)]
    arrays += [layer.weight for layer in start.layers] if start is not None else []
    known = [sorted(each.known.items()) for each in samples]
    settings = {"training": asdict(training), "teaching": asdict(teaching), "known": known}
    return content_key("unsupervised 2", *arrays, seed=seed, **settings)
