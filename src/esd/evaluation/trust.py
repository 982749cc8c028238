"""How far a model can be trusted on shapes whose true correspondences are not known."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from functools import partial
from types import MappingProxyType

import numpy as np

from esd.common import InputError
from esd.datasets.collection import Collection, Shape
from esd.learning.model import Model
from esd.matching.match import match
from esd.parallel import THIS_PROCESS, Workers, outcomes
from esd.spectral.cache import Cache

FAILED = "failed"


def verdicts(
    model: Model,
    collection: Collection,
    *,
    count: int = 12,
    seed: int = 0,
    workers: Workers = THIS_PROCESS,
    cache: Cache | None = None,
    on_pair: Callable[[], None] = lambda: None,
) -> Mapping[str, int]:
    """Number of maps of each verdict, see `esd.matching.confidence`, the most frequent first.

    Maps that could not be computed have failed.

    Parameters
    ----------
    collection
        Whose shapes are matched, each with the next one in a random order.
    count
        Largest number of maps.
    seed
        Of the order.
    workers
        What computes.
    on_pair
        Called after each map.

    Raises
    ------
    InputError
        If there are fewer than two shapes.
    """
    if len(collection.shapes) < 2:
        raise InputError(f"Maps need two shapes or more; got {len(collection.shapes)}.")
    order = np.random.default_rng(seed).permutation(len(collection.shapes)).tolist()
    shapes = [collection.shapes[i] for i in order]
    pairs = list(zip(shapes, [*shapes[1:], shapes[0]], strict=True))[:count]
    found: Counter[str] = Counter()
    for outcome in outcomes(partial(_verdict, model=model, cache=cache), pairs, workers=workers):
        found[outcome.result or FAILED] += 1
        on_pair()
    return MappingProxyType(dict(found.most_common()))


def _verdict(pair: tuple[Shape, Shape], *, model: Model, cache: Cache | None) -> str:
    found = match(pair[0].mesh(), pair[1].mesh(), model=model, cache=cache)
    return FAILED if found.judgement is None else found.judgement.verdict
