"""Maps of a collection as a whole: through the chain of shapes whose maps are trusted most."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import permutations

import numpy as np
from scipy.sparse import csgraph

from esd.common import FloatArray, InputError, IntArray

Pair = tuple[int, int]
"""Numbers of a source and of a target, different from each other."""

_SHAPES = 30  # among which triples are looked for


def trusted_chains(accuracy: Mapping[Pair, float], count: int) -> dict[Pair, tuple[int, ...]]:
    """The chain of shapes from each shape to each other one along which most matches stay right.

    The length of a map is −log of its accuracy, so that the shortest chain has the largest product
    of accuracies. Pairs that no chain connects are left out.

    Parameters
    ----------
    accuracy
        Expected share of right matches of the maps that there are, from 0 to 1.
    count
        Number of shapes.

    Returns
    -------
    chains
        Numbers of shapes from the source to the target, both included; two for a direct map.

    Raises
    ------
    InputError
        If an accuracy is not from 0 to 1.

    References
    ----------
    Nguyen, Ben-Chen, Welnicka, Ye, Guibas 2011, *An optimization approach to improving collections
    of shape maps*.
    """
    wrong = [value for value in accuracy.values() if not 0 <= value <= 1]
    if wrong:
        raise InputError(f"Accuracies are from 0 to 1; got {wrong[0]}.")
    length = np.full((count, count), np.inf)
    for pair, value in accuracy.items():
        # a sure map has a length too: of two equal chains the shorter is taken
        length[pair] = 1e-6 - np.log(max(value, 1e-12))
    graph = csgraph.csgraph_from_dense(length, null_value=np.inf)
    _, before = csgraph.shortest_path(graph, return_predecessors=True)
    chains = {}
    for source, target in permutations(range(count), 2):
        chain = [target]
        while chain[0] != source and before[source, chain[0]] >= 0:
            chain.insert(0, int(before[source, chain[0]]))
        if chain[0] == source:
            chains[source, target] = tuple(chain)
    return chains


def composed(maps: Sequence[IntArray]) -> IntArray:
    """The map along a chain of maps, (n,): -1 where a match is missing on the way.

    Parameters
    ----------
    maps
        One or more: the target vertex of each source vertex, (n,), -1 for none; the targets of one
        are the sources of the next.
    """
    index = maps[0]
    for following in maps[1:]:
        # source vertex -> vertex of the shape between -> vertex of the next one
        index = np.where(index >= 0, following[index], -1)
    return index


def cycle_miss(
    maps: Mapping[Pair, IntArray], positions: Mapping[int, FloatArray], *, cycles: int = 500
) -> float | None:
    """Mean distance between images by way of a third shape and by the direct map.

    Parameters
    ----------
    positions : (n, 3) each
        Of the vertices of each shape that has maps, in units of √area; NaN for those left out.
    cycles
        Number of triples of shapes that are looked at, drawn at random where there are more, and
        among thirty shapes at the most.

    Returns
    -------
    miss
        In units of √area; None where no three maps close.
    """
    generator = np.random.default_rng(0)
    shapes = generator.permutation(sorted(positions))[:_SHAPES].tolist()
    triples = [
        triple
        for triple in permutations(shapes, 3)
        if {(triple[0], triple[1]), (triple[1], triple[2]), (triple[0], triple[2])} <= maps.keys()
    ]
    chosen = generator.permutation(len(triples))[:cycles].tolist()
    misses = []
    for a, b, c in (triples[i] for i in chosen):
        direct, by_way = maps[a, c], composed([maps[a, b], maps[b, c]])
        both = (direct >= 0) & (by_way >= 0)
        apart = positions[c][direct[both]] - positions[c][by_way[both]]
        if np.isfinite(apart).any():
            misses.append(float(np.nanmean(np.linalg.norm(apart, axis=1))))
    return float(np.mean(misses)) if misses else None
