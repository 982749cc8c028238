"""Adaptation of an embedding to two shapes whose correspondences are not known."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import torch

from esd.learning.model import Model
from esd.learning.optimise import adam_with_moments, descend
from esd.learning.presets import PRESETS
from esd.learning.samples import Samples
from esd.learning.teacher import FIRST_SIZES, Lesson, is_reliable, lesson
from esd.learning.updates import (
    Matches,
    embedding_by,
    infonce_of_matches,
    layers_of,
    network_of,
)

_STEPS = 16  # maps that are learned from, each with a few updates
_UPDATES = 4
_DRAWN, _BATCH = 1500, 400  # points of either shape that are matched, and matches in an update
_RATE = 1e-3  # of Adam in the first step; it falls as a cosine
_LAST_RATE = 0.05  # share of it in the last step
_LAST_SIZE = 100  # eigenfunctions of the refinement in the last step


def adapted(
    model: Model, source: Samples, target: Samples, *, first: Lesson | None = None, seed: int = 0
) -> Model:
    """A model after some steps of learning on two shapes, from maps between them that it finds.

    In each step the map by the embeddings is refined with up to more and more eigenfunctions; what
    can be relied on of it, see `esd.learning.teacher`, and on deformed copies of either shape, is
    learned from.

    Parameters
    ----------
    model
        Fully connected, with embeddings of unit length. A network that it has beside its layers is
        left out.
    source, target
        Samples with descriptors standardised as the model's, and with copies if wanted.
    first
        Matches that are learned where the map by the embeddings is not reliable.
    seed
        Of all that is random.

    Raises
    ------
    InputError
        If the model is of another kind.

    References
    ----------
    Cao, Roetzer, Bernard 2023, *Unsupervised learning of robust spectral shape matching*, for
    adapting to the pair at hand.
    """
    network = network_of(model)
    optimiser = adam_with_moments(network, rate=_RATE)
    training = PRESETS["oriented"]
    generator = np.random.default_rng(seed)
    dropout = torch.Generator().manual_seed(seed)
    pairs = [(source, target)] + [(each, each) for each in (source, target) if each.values[1:]]
    for step in range(_STEPS):
        share = step / (_STEPS - 1)
        end = round(FIRST_SIZES[-1] + (_LAST_SIZE - FIRST_SIZES[-1]) * share)
        found = lesson(
            source,
            target,
            embedding_by(network),
            sizes=(*FIRST_SIZES, round(math.sqrt(FIRST_SIZES[-1] * end)), end),
            count=_DRAWN,
            generator=generator,
        )
        if not is_reliable(found):
            if first is None or not is_reliable(first):
                continue
            found = first
        rate = _RATE * (_LAST_RATE + (1 - _LAST_RATE) * (1 + math.cos(math.pi * share)) / 2)
        for update in range(_UPDATES):
            # the map between the two in every other update, copies of either in the others
            shapes = pairs[0] if update % 2 == 0 else pairs[generator.integers(len(pairs))]
            taught = found if shapes[0] is not shapes[1] else _itself(shapes[0], generator)
            loss = infonce_of_matches(
                network,
                Matches(*shapes, taught),
                training,
                batch=_BATCH,
                generator=generator,
                dropout=dropout,
            )
            descend(optimiser, loss, rate=rate)
    return replace(model, layers=layers_of(network), diffusion=None)


def _itself(samples: Samples, generator: np.random.Generator) -> Lesson:
    """Matches of a shape with its own copies."""
    rows = generator.permutation(len(samples.positions))[:_DRAWN]
    return Lesson(rows, rows, 1.0, 1.0, 1.0)
