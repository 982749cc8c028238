"""What training minimises, and the criteria by which an embedding of pairs is judged."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from esd.common import FloatArray


def contrastive_loss(squared_distance: Any, label: Any, *, margin: float) -> Any:
    """Loss of each pair, (b,): y d² + (1 − y) max(0, C − d²).

    Works on arrays and on tensors alike.

    Parameters
    ----------
    squared_distance : (b,)
        d², squared distances of the embedded pairs.
    label : (b,)
        y, one for pairs that correspond.
    margin
        C, a bound on the squared distance (equation 7 of the paper, which takes 5).
    """
    return label * squared_distance + (1 - label) * (margin - squared_distance).clip(min=0)


def infonce_loss(
    source: Any, target: Any, *, temperature: float, ignored: Any | None = None
) -> Any:
    """Loss of each of b corresponding pairs, (b,): log Σₖ exp(sᵢ·tₖ / τ) − sᵢ·tᵢ / τ, both ways.

    The cross-entropy of finding the match of a point among all points of the batch, the mean of
    finding the target's and finding the source's.

    Parameters
    ----------
    source, target : (b, d) tensors
        Embedded points, rows of unit length; row i of one corresponds to row i of the other.
    temperature
        τ.
    ignored : (b, b) bool tensor
        Which points of the target (columns) are no wrong matches of those of the source, and do
        not count; symmetric, and false on the diagonal.

    References
    ----------
    van den Oord, Li, Vinyals 2018, *Representation learning with contrastive predictive coding*,
    equation 4; symmetric as in Radford et al. 2021.
    """
    similarity = source @ target.T / temperature
    if ignored is not None:
        similarity = similarity.masked_fill(ignored, -float("inf"))
    ways = similarity.logsumexp(dim=0) + similarity.logsumexp(dim=1)
    return ways / 2 - similarity.diagonal()


@dataclass(frozen=True, slots=True)
class PairCriteria:
    """The paper's criteria (section 3.6) over a set of pairs.

    Parameters
    ----------
    loss_sum
        Sum of the contrastive loss: the paper's LSS.
    loss_mean
        The same, a pair.
    miss_rate
        Share of the corresponding pairs that lie farther apart than the threshold; the paper
        calls it true-negative rate (TNR).
    false_match_rate
        Share of the other pairs that lie nearer: the paper's FPR.
    error_rate
        Sum of the two: the paper's ERR.
    """

    loss_sum: float
    loss_mean: float
    miss_rate: float
    false_match_rate: float
    error_rate: float


def pair_criteria(
    squared_distance: FloatArray, label: FloatArray, *, margin: float
) -> PairCriteria:
    """Criteria of embedded pairs, those with label one being the corresponding ones.

    The threshold is half of the margin, both on the squared distance.
    """
    loss = contrastive_loss(squared_distance, label, margin=margin)
    match = label == 1
    miss = float((squared_distance[match] > margin / 2).mean())
    false_match = float((squared_distance[~match] <= margin / 2).mean())
    total = float(np.sum(loss, dtype=np.float64))
    return PairCriteria(total, total / len(label), miss, false_match, miss + false_match)
