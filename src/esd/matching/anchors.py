"""Matches at a few samples whose distances along both surfaces agree with each other."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from esd.common import BoolArray, FloatArray, IntArray
from esd.mesh.geometry import unit

_CANDIDATES = 5  # targets of each source sample
_APART = 0.1  # least distance between these, in √area of the whole
_TEMPERATURE = 0.07  # of products of rows, as embeddings are trained
_UNARY = 0.5  # weight of rows beside the agreement of distances
_PAIRWISE = 12.0
_STEPS, _RISING = 30, 10  # of relaxation, and those in which the second weight rises
_ABSOLUTE, _RELATIVE = 0.03, 0.08  # deviation of distances that agree: people differ
_LOCAL = 0.8  # distance beyond which pairs are not compared
_SOFT = 0.1  # added to distances by whose inverse pairs are weighted
_POWER_STEPS = 20
_MEASURED = 0.1, 0.6  # distances of which it is measured how much longer they become
_ROUNDING = 0.01
_NEAR = 0.05  # distances to a point below this count as about the same
_SHARED, _SLOPE = 0.75, 0.05  # of the agreement of the best, at which a sample counts half
_BEST = 0.8  # quantile of samples whose agreement is that of the best
_TURNS, _SCALED = 8, 3  # of weighting samples, and those in which the lengths are compared
_LEAST = 1e-9
_FEWEST = 8  # samples by which they are


@dataclass(frozen=True, slots=True, eq=False)
class Anchors:
    """Samples of two shapes that correspond.

    Parameters
    ----------
    source, target : (k,)
        Their places among the samples of each.
    support : (k,)
        How well the distances of each from the others agree on both shapes, over that of the best.
    agreement
        The mean of that, from 0 to 1.
    enlargement
        How much longer distances are on the target, where they agree.
    """

    source: IntArray
    target: IntArray
    support: FloatArray
    agreement: float
    enlargement: float


def anchors(similarity: FloatArray, source_ways: FloatArray, target_ways: FloatArray) -> Anchors:
    """For each source sample, the target sample that fits the others best.

    Each source sample may go to a few of the most similar target samples that lie apart. A choice
    is supported by those of other samples whose distances from it are equal on both shapes;
    choices are relaxed together, and what finds no support counts less and less.

    Parameters
    ----------
    similarity : (k, m)
        Of source samples with target samples.
    source_ways : (k, k), target_ways : (m, m)
        Distances along the surfaces between samples, in √area of the whole.

    References
    ----------
    Leordeanu, Hebert 2005, *A spectral technique for correspondence problems using pairwise
    constraints*; Rosenfeld, Hummel, Zucker 1976, for the relaxation.
    """
    count = len(similarity)
    choice = _candidates(similarity, target_ways)  # (k, c), columns of `similarity`
    unary = np.take_along_axis(similarity, choice, axis=1)
    unary = _UNARY * (unary - unary.max(axis=1, keepdims=True)) / _TEMPERATURE
    flat = choice.ravel()
    between = target_ways[np.ix_(flat, flat)].reshape(*choice.shape, *choice.shape)
    agree = _agreement(source_ways[:, None, :, None], between)  # (k, c, k, c)
    weight = _weight(source_ways)
    np.fill_diagonal(weight, 0.0)
    weight /= np.maximum(weight.sum(axis=1, keepdims=True), np.finfo(float).tiny)
    share = _softmax(unary)
    support = np.ones(count)
    for step in range(_STEPS):
        votes = np.einsum("ij,iajb,jb->ia", weight * support, agree, share, optimize=True)
        share = _softmax(unary + _PAIRWISE * min(1.0, (step + 1) / _RISING) * votes)
        if step >= _RISING:
            support = (votes * share).sum(axis=1)
            support /= max(float(support.max()), np.finfo(float).tiny)
    index = choice[np.arange(count), share.argmax(axis=1)]
    there = target_ways[np.ix_(index, index)]
    agree = _agreement(source_ways, there)
    compared = np.outer(support, support) * agree
    compared[(source_ways < _MEASURED[0]) | (source_ways > _MEASURED[1])] = 0.0
    longer = np.log((there + _ROUNDING) / (source_ways + _ROUNDING))
    return Anchors(
        np.arange(count),
        index,
        support,
        float(((weight * agree) @ support).mean()),
        float(np.exp(_median(longer.ravel(), compared.ravel()))),
    )


def nearness(ways: FloatArray) -> FloatArray:
    """Rows (n, k) of unit length that say how near each vertex is to each of some points.

    1 / (d + 0.05) for the distance d in √area; zero where there is no way.

    Parameters
    ----------
    ways : (k, n)
        The distances.
    """
    return unit(1 / (ways.T + _NEAR))


def agreement(source_ways: FloatArray, image_ways: FloatArray, places: IntArray) -> FloatArray:
    """How far each vertex keeps its distances from those samples that keep theirs, (n,), 0 to 1.

    The samples are weighted by how far they agree with each other, as the leading eigenvector of
    their agreement says; what is mapped smoothly to a wrong limb agrees with itself and not with
    the rest.

    Parameters
    ----------
    source_ways : (k, n)
        Distances from samples.
    image_ways : (k, n)
        Distances of the images from the images of the samples.
    places : (k,)
        The vertices that are the samples.
    """
    weight = _weight(np.minimum(source_ways, image_ways))
    agree = weight * _agreement(source_ways, image_ways)
    among, total = _of_others(agree, places), _of_others(weight, places)
    least = np.finfo(float).tiny
    support = np.ones(len(places))
    for _ in range(_POWER_STEPS):
        support = support @ among / np.maximum(total.sum(axis=0), least)
        support /= max(float(support.max()), least)
    result = support @ agree / np.maximum(weight.sum(axis=0), least)
    return np.asarray(result / max(float(result.max()), least))


def agreement_with_most(
    source_ways: FloatArray,
    image_ways: FloatArray,
    places: IntArray,
    lying: BoolArray,
    *,
    slack: tuple[float, float] = (1.0, 1.0),
) -> tuple[FloatArray, float]:
    """As `agreement`, with those samples alone that agree with each other, (n,), about 0 to 1.

    And the share of the samples that may count which does.

    What is mapped to a wrong limb agrees with itself; here it is measured by the rest. A sample
    counts as far as it agrees with the others that count, and 1 is the agreement of the best of
    these. Lengths may differ by a factor, which is measured.

    Parameters
    ----------
    source_ways, image_ways, places
        As those of `agreement`.
    lying : (k,)
        Which samples may count.
    slack
        How many times as much distances may be too long on the source, and on the target: ways
        lead around what is missing.
    """
    support, scale = lying.astype(float), 1.0
    own = source_ways[:, places], image_ways[:, places]
    compared = (own[0] > _MEASURED[0]) & (own[0] < _MEASURED[1])
    longer = np.log((own[1] + _ROUNDING) / (own[0] + _ROUNDING))
    for turn in range(_TURNS):
        if turn < _SCALED:
            used = support > 0.5 if np.count_nonzero(support > 0.5) >= _FEWEST else lying
            counted = compared & used & used[:, None]
            scale = np.exp(np.median(longer[counted])) if counted.any() else 1.0
            ways = np.float32(scale) * source_ways
            deviation = (ways - image_ways) / (_ABSOLUTE + _RELATIVE * np.minimum(ways, image_ways))
            weight = _weight(np.minimum(ways, image_ways))
            agree = weight / (1 + np.where(deviation > 0, *(deviation / s for s in slack)) ** 2)
            among, total = _of_others(agree, places), _of_others(weight, places)
        mean = (support @ among) / np.maximum(support @ total, _LEAST)
        best = np.quantile(mean[support > 0.2], _BEST) if (support > 0.2).any() else 1.0
        best = max(float(best), _LEAST)
        support = lying / (1 + np.exp(-(mean / best - _SHARED) / _SLOPE))
    kept = (support @ agree) / np.maximum(support @ weight, _LEAST) / best
    return np.asarray(kept), float(support.sum() / max(lying.sum(), 1))


def _of_others(values: FloatArray, places: IntArray) -> FloatArray:
    """Values of samples at the samples, (k, k), without those of each at itself."""
    result = values[:, places].copy()
    np.fill_diagonal(result, 0.0)
    return result


def _candidates(similarity: FloatArray, target_ways: FloatArray) -> IntArray:
    """The most similar target samples of each source sample that lie apart, (k, c)."""
    left = similarity.astype(np.float64)
    rows = np.arange(len(left))
    choice = np.empty((len(left), _CANDIDATES), dtype=np.int64)
    for column in range(_CANDIDATES):
        choice[:, column] = left.argmax(axis=1)
        if column:  # where none is left, the best again
            none = np.isneginf(left[rows, choice[:, column]])
            choice[none, column] = choice[none, 0]
        left[target_ways[choice[:, column]] < _APART] = -np.inf
    return choice


def _agreement(one: FloatArray, other: FloatArray) -> FloatArray:
    deviation = _ABSOLUTE + _RELATIVE * np.minimum(one, other)
    return np.exp(-(((one - other) / deviation) ** 2) / 2)


def _weight(ways: FloatArray) -> FloatArray:
    return np.where(ways < _LOCAL, 1 / (ways + _SOFT), 0.0)


def _median(values: FloatArray, weights: FloatArray) -> float:
    order = np.argsort(values)
    total = np.cumsum(weights[order])
    return float(values[order[np.searchsorted(total, total[-1] / 2)]])


def _softmax(values: FloatArray) -> FloatArray:
    result = np.exp(values - values.max(axis=1, keepdims=True))
    return np.asarray(result / result.sum(axis=1, keepdims=True))
