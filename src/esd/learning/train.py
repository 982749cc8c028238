"""Training of an embedding."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch

from esd.common import FloatArray, InputError
from esd.datasets.collection import Collection
from esd.datasets.remeshing import with_remeshings
from esd.learning.device import usable_device
from esd.learning.losses import contrastive_loss, infonce_loss
from esd.learning.model import Layer, Model
from esd.learning.network import convolved, seeded_network
from esd.learning.optimise import (
    adam_with_moments,
    descend,
)
from esd.learning.pairs import PairBatch, draw_matches, draw_pairs
from esd.learning.presets import Training
from esd.learning.run import Run, first_run, weights_of
from esd.learning.table import PointTable, point_table, standardisation, stored_table
from esd.parallel import THIS_PROCESS, Workers
from esd.spectral.cache import Cache, content_key

_VALIDATION_BATCHES = 40
_LARGEST_SEED = 2**32 - 1
_LARGE_STEP = 10**8  # multiplications in a step's products
_LAST_RATE = 0.05  # of the learning rate, where it falls as a cosine


@dataclass(frozen=True, slots=True)
class Progress:
    """How far a training has come.

    Parameters
    ----------
    step, steps
        Steps done, and to be done at the most.
    training_loss
        Mean over the training pairs since the last report.
    validation_loss
        Mean over the validation pairs at the last validation; None without validation shapes.
    """

    step: int
    steps: int
    training_loss: float
    validation_loss: float | None


@dataclass(frozen=True, slots=True, eq=False)
class _HeldOut:
    """Batches of validation pairs, the same at each validation."""

    table: PointTable
    batches: tuple[PairBatch, ...]


@dataclass(frozen=True, slots=True, eq=False)
class _Data:
    """What a training sees: standardised descriptors, by which mean and deviation, (width,)."""

    table: PointTable
    mean: FloatArray
    deviation: FloatArray
    held_out: _HeldOut | None


def train(
    collection: Collection,
    training: Training,
    *,
    name: str = "model",
    seed: int = 0,
    validation: Collection | None = None,
    checkpoint: str | os.PathLike[str] | None = None,
    device: str = "cpu",
    workers: Workers = THIS_PROCESS,
    cache: Cache | None = None,
    on_shape: Callable[[], None] = lambda: None,
    on_progress: Callable[[Progress], None] = lambda _: None,
) -> Model:
    """The embedding learned from pairs of points of a collection.

    Equal arguments and equal numbers of threads give equal weights, also when the training was
    interrupted and resumed from its checkpoint.

    Parameters
    ----------
    collection
        Of meshes, or of a store (`esd.datasets.store.store_collection`), of which each step reads
        the points that it draws, and `training.points` is not needed.
    name
        Of the model.
    validation
        Shapes of other subjects. Given these, the weights with the lowest loss on them are kept,
        and training stops when it has not fallen at ten validations (`training.validate_every`).
    checkpoint
        A file from which an interrupted training resumes, and which is removed at its end.
    device
        Where the network is trained, see `usable_device`. What is drawn at random is the same on
        all, so that they differ by rounding alone.
    workers
        What describes the shapes; training itself runs in this process.
    cache
        Where spectra are looked up and kept.
    on_shape, on_progress
        Called after each shape is described, and from time to time during the training.

    Raises
    ------
    InputError
        If the shapes cannot be described, the checkpoint belongs to another training,
        convolutions are asked for without whole shapes, or torch has no such device.
    """
    if training.patches is not None and (collection.store or training.points is not None):
        raise InputError(
            "Convolutions need whole shapes: train on meshes, not on a store, and on all points."
        )
    place = torch.device(usable_device(device))
    if not 0 <= seed <= _LARGEST_SEED:
        raise InputError(f"`seed` must be from 0 to {_LARGEST_SEED}; got {seed}.")
    data = _training_data(
        collection, validation, training, seed, workers=workers, cache=cache, on_shape=on_shape
    )
    with _threads(training):
        run = _start(training, seed, place)
        path = None if checkpoint is None else Path(checkpoint)
        _run_to_the_end(run, data, training, seed, path, on_progress)
        return Model(
            name=name,
            recipe=training.recipe,
            mean=data.mean,
            deviation=data.deviation,
            layers=_layers(weights_of(run.network) if data.held_out is None else run.best_weights),
            margin=training.margin if training.loss == "contrastive" else None,
            limit=training.limit,
            unit_length=training.loss == "infonce",
            patches=training.patches,
            card=_card(collection, validation, training, seed, run),
        )


def _training_data(
    collection: Collection,
    validation: Collection | None,
    training: Training,
    seed: int,
    *,
    workers: Workers,
    cache: Cache | None,
    on_shape: Callable[[], None],
) -> _Data:
    """The standardised descriptors of all shapes, and the pairs to validate on."""
    describe = partial(
        point_table,
        recipe=training.recipe,
        points=training.points,
        half=training.points is not None and training.standardise,
        patches=training.patches,
        workers=workers,
        cache=cache,
        on_shape=on_shape,
    )
    if collection.store is not None:
        describe = partial(stored_table, recipe=training.recipe)
        table = stored_table(collection, training.recipe, copies=training.remeshings)
    else:
        table = describe(with_remeshings(collection, training.remeshings, seed=seed))
    mean, deviation = standardisation(table, wanted=training.standardise)
    table = table.standardised(mean, deviation, limit=training.limit, in_place=True)
    held_out = None
    if validation is not None:
        held = describe(validation).standardised(
            mean, deviation, limit=training.limit, in_place=True
        )
        batches = (_draw(held, training, _LARGEST_SEED, i) for i in range(_VALIDATION_BATCHES))
        held_out = _HeldOut(held, tuple(batches))
    return _Data(table, mean, deviation, held_out)


def _run_to_the_end(
    run: Run[torch.nn.Sequential],
    data: _Data,
    training: Training,
    seed: int,
    checkpoint: Path | None,
    on_progress: Callable[[Progress], None],
) -> None:
    """All steps from those that the checkpoint has, until the last or the validation's patience."""
    identity = _identity(data, training, seed)
    if checkpoint is not None and checkpoint.exists():
        run.resume(checkpoint, identity=identity)
    while run.step < training.steps and not (
        data.held_out and run.is_exhausted(training.validate_every)
    ):
        training_loss = _advance(run, data.table, training, seed)
        loss = None if data.held_out is None else _validate(run, data.held_out, training)
        run.curve.append((run.step, training_loss, loss))
        if checkpoint is not None:
            run.save(checkpoint, identity=identity)
        on_progress(Progress(run.step, training.steps, training_loss, loss))
    if checkpoint is not None:
        checkpoint.unlink(missing_ok=True)


@contextmanager
def _threads(training: Training) -> Iterator[None]:
    """One thread for a small network: sharing out its short steps takes longer than they do."""
    widths = (training.recipe.width, *training.hidden, training.outputs)
    products = 2 * training.batch * sum(a * b for a, b in pairwise(widths))
    before = torch.get_num_threads()
    if training.patches is None and products < _LARGE_STEP:
        torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def _draw(table: PointTable, training: Training, seed: int, step: int) -> PairBatch:
    """The batch of a step, which has a random generator of its own."""
    generator = np.random.default_rng((seed, step))
    if training.loss == "infonce":
        return draw_matches(table, generator, count=training.batch)
    return draw_pairs(table, generator, count=training.batch, soft_label=training.soft_label)


def _start(training: Training, seed: int, device: torch.device) -> Run[torch.nn.Sequential]:
    widths = [training.recipe.width, *training.hidden, training.outputs]
    network = seeded_network(widths, seed, training.patches, training.convolutions).to(device)
    optimiser = adam_with_moments(network, rate=training.learning_rate)
    return first_run(network, optimiser)


def _advance(
    run: Run[torch.nn.Sequential], table: PointTable, training: Training, seed: int
) -> float:
    """Train to the next validation, or the last step; the mean loss of a pair on the way."""
    stop = min(run.step + training.validate_every, training.steps)
    losses = []
    for step in range(run.step, stop):
        batch = _draw(table, training, seed, step)
        dropout = torch.Generator().manual_seed(_LARGEST_SEED * step + seed)
        loss = _losses(run.network, table, batch, training, dropout=dropout)
        descend(run.optimiser, loss.sum(), rate=learning_rate(training, step))
        losses.append(loss.detach().mean())
    run.step = stop
    return float(torch.stack(losses).double().mean())


def learning_rate(training: Training, step: int) -> float:
    """Learning rate of a step, from 0."""
    if training.schedule == "exponential":
        return training.learning_rate * training.decay**step
    fall = (1 + math.cos(math.pi * step / training.steps)) / 2
    return training.learning_rate * (_LAST_RATE + (1 - _LAST_RATE) * fall)


def _losses(
    network: torch.nn.Sequential,
    table: PointTable,
    batch: PairBatch,
    training: Training,
    *,
    dropout: torch.Generator | None = None,
) -> torch.Tensor:
    """Loss of each pair of a batch, (b,); with descriptors dropped at random, or all there."""
    device = next(network.parameters()).device
    if training.patches is not None:
        shapes = [table.whole_shape(rows) for rows in (batch.source, batch.target)]
        embedded = torch.cat(
            [
                convolved(
                    network,
                    _dropped(shape.values, training, dropout).to(device),
                    shape.operator,
                    shape.vertices,
                )
                for shape in shapes
            ]
        )
    else:
        rows = np.concatenate([batch.source, batch.target])
        embedded = network(_dropped(table.at(rows), training, dropout).to(device))
    if training.loss == "infonce":
        source, target = torch.nn.functional.normalize(embedded, dim=1).chunk(2)
        return infonce_loss(source, target, temperature=training.temperature)
    source, target = embedded.chunk(2)
    squared = ((source - target) ** 2).sum(dim=1)
    return contrastive_loss(
        squared, torch.from_numpy(batch.label).to(device), margin=training.margin
    )


def _dropped(
    values: npt.NDArray[np.float32], training: Training, dropout: torch.Generator | None
) -> torch.Tensor:
    """Descriptors (r, width), some of them set to zero if there is a generator."""
    described = torch.from_numpy(values)
    if not training.dropout or dropout is None:
        return described
    kept = torch.rand(described.shape, generator=dropout) >= training.dropout
    return described * kept / (1 - training.dropout)


def _validate(run: Run[torch.nn.Sequential], held_out: _HeldOut, training: Training) -> float:
    """The loss on the validation pairs; the weights are noted if they are the best so far."""
    with torch.no_grad():
        losses = [
            _losses(run.network, held_out.table, batch, training) for batch in held_out.batches
        ]
    mean = float(torch.cat(losses).double().mean())
    run.note(mean)
    return mean


def _layers(weights: list[torch.Tensor]) -> tuple[Layer, ...]:
    pairs = zip(weights[::2], weights[1::2], strict=True)
    return tuple(Layer(weight.cpu().numpy(), bias.cpu().numpy()) for weight, bias in pairs)


def _identity(data: _Data, training: Training, seed: int) -> str:
    """What a training depends on; a checkpoint is resumed only by the same."""
    arrays = _content(data.table)
    if data.held_out is not None:
        batches = data.held_out.batches
        arrays += [*_content(data.held_out.table), *(batch.source for batch in batches)]
    return content_key("training 2", *arrays, training=asdict(training), seed=seed)


def _content(table: PointTable) -> list[npt.NDArray[Any]]:
    if table.stored is not None:
        return [np.array(table.stored.keys)]
    return [table.values, *table.rows]


def _card(
    collection: Collection,
    validation: Collection | None,
    training: Training,
    seed: int,
    run: Run[torch.nn.Sequential],
) -> dict[str, Any]:
    settings = asdict(training)
    del settings["recipe"]  # the model has it
    return {
        "data": collection.name,
        "shapes": [shape.name for shape in collection.shapes],
        "validation_shapes": [shape.name for shape in validation.shapes] if validation else [],
        "validation_loss": run.best_loss if validation else None,
        "training": settings,
        "seed": seed,
        "steps_done": run.step,
        "curve": run.curve,
        "device": str(next(run.network.parameters()).device),
        "threads": torch.get_num_threads(),
        "torch": str(torch.__version__),
    }
