"""The model of a training, by whichever way it is learned."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import asdict
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from esd.common import FloatArray
from esd.datasets.collection import Collection
from esd.learning.model import Layer, Model
from esd.learning.osd import optimal_metric, with_knots
from esd.learning.pairs import draw_pairs
from esd.learning.presets import Training
from esd.learning.table import PointTable, point_table, standardisation, stored_table
from esd.parallel import THIS_PROCESS, Workers
from esd.spectral.cache import Cache

if TYPE_CHECKING:
    from esd.learning.train import Progress


def fit(
    collection: Collection,
    training: Training,
    *,
    name: str = "model",
    seed: int = 0,
    validation: Collection | None = None,
    start: Model | None = None,
    checkpoint: str | os.PathLike[str] | None = None,
    device: str = "cpu",
    workers: Workers = THIS_PROCESS,
    cache: Cache | None = None,
    on_shape: Callable[[], None] = lambda: None,
    on_progress: Callable[[Progress], None] = lambda _: None,
) -> Model:
    """The model learned from a collection.

    By `osd`, by `esd.learning.part_training.train_on_parts` where the training has blocks, or by
    `esd.learning.train.train`. Only the first does without torch; all parameters, and the errors
    raised, are those of the others. Only the second starts from a model.
    """
    if training.loss == "osd":
        return osd(
            collection,
            training,
            name=name,
            seed=seed,
            validation=validation,
            workers=workers,
            cache=cache,
            on_shape=on_shape,
        )
    learn: Callable[..., Model]
    if training.blocks:
        from esd.learning.part_training import train_on_parts

        learn = partial(train_on_parts, start=start)
    else:
        from esd.learning.train import train as learn
    return learn(
        collection,
        training,
        name=name,
        seed=seed,
        validation=validation,
        checkpoint=checkpoint,
        device=device,
        workers=workers,
        cache=cache,
        on_shape=on_shape,
        on_progress=on_progress,
    )


def osd(
    collection: Collection,
    training: Training,
    *,
    name: str = "model",
    seed: int = 0,
    validation: Collection | None = None,
    workers: Workers = THIS_PROCESS,
    cache: Cache | None = None,
    on_shape: Callable[[], None] = lambda: None,
) -> Model:
    """Optimal spectral descriptors of a collection: a model of one layer, in closed form.

    Parameters
    ----------
    validation
        Shapes of other subjects, on which nothing depends but what the model's card says of them.
    workers
        What describes the shapes.
    on_shape
        Called after each shape is described.

    Raises
    ------
    InputError
        If the shapes cannot be described, or there are fewer descriptors than outputs.
    """

    def described(part: Collection) -> PointTable:
        if part.store is not None:
            return stored_table(part, recipe)
        return point_table(
            part,
            recipe,
            points=training.points,
            workers=workers,
            cache=cache,
            on_shape=on_shape,
        )

    recipe = training.recipe
    if collection.store is None:
        recipe = with_knots(recipe, collection, cache=cache)
    table = described(collection)
    mean, deviation = standardisation(table, wanted=training.standardise)
    near, far = _differences(table.standardised(mean, deviation), training, seed)
    metric = optimal_metric(near, far, training.outputs)
    card: dict[str, Any] = {
        "data": collection.name,
        "shapes": [shape.name for shape in collection.shapes],
        "separation": _separation(metric, near, far),
    }
    if validation is not None:
        held = _differences(described(validation).standardised(mean, deviation), training, seed)
        card["validation_shapes"] = [shape.name for shape in validation.shapes]
        card["validation_separation"] = _separation(metric, *held)
    settings = asdict(training)
    del settings["recipe"]  # the model has it
    return Model(
        name=name,
        recipe=recipe,
        mean=mean,
        deviation=deviation,
        layers=(Layer(metric.astype(np.float32), np.zeros(len(metric), dtype=np.float32)),),
        card={**card, "training": settings, "seed": seed, "steps_done": training.steps},
    )


def _differences(table: PointTable, training: Training, seed: int) -> tuple[FloatArray, FloatArray]:
    """Differences of descriptors between points that correspond, and between others."""
    batches = [
        draw_pairs(
            table,
            np.random.default_rng((seed, step)),
            count=training.batch,
            soft_label=training.soft_label,
        )
        for step in range(training.steps)
    ]
    corresponds = np.concatenate([batch.label for batch in batches]) == 1
    source, target = (
        table.at(np.concatenate(rows)).astype(np.float64)
        for rows in ([batch.source for batch in batches], [batch.target for batch in batches])
    )
    return (source - target)[corresponds], (source - target)[~corresponds]


def _separation(metric: FloatArray, near: FloatArray, far: FloatArray) -> float:
    """How many times farther apart points that do not correspond are, in squared distance."""
    return float(((far @ metric.T) ** 2).mean() / ((near @ metric.T) ** 2).mean())
