"""How far a map is from the truth."""

from __future__ import annotations

import numpy as np

from esd.common import FloatArray, IntArray
from esd.mesh.geodesics import EdgeGraph

_CHUNK = 256


def geodesic_errors(
    graph: EdgeGraph,
    predicted: IntArray,
    truths: tuple[IntArray, ...],
    *,
    limit: float = np.inf,
) -> tuple[FloatArray, ...]:
    """Geodesic distances from predicted to true vertices of one mesh, (p,) for each of the truths.

    Distances are taken only from those vertices that occur, from the smaller of the two sides.

    Parameters
    ----------
    graph
        Of the mesh, see `geodesic_graph`.
    predicted : (p,)
        Vertices from 0; -1 for none, where the result is NaN.
    truths : (p,) each
        True vertices from 0, such as the direct and the mirrored ones; -1 where unknown: NaN.
    limit
        Longer distances may come out as infinite, which saves most of the time.
    """
    known = [(predicted >= 0) & (truth >= 0) for truth in truths]
    near = np.concatenate([predicted[k] for k in known])
    far = np.concatenate([truth[k] for truth, k in zip(truths, known, strict=True)])
    if len(np.unique(far)) < len(np.unique(near)):
        near, far = far, near
    distance = np.empty(len(near))
    order = np.argsort(near, kind="stable")
    sources, first = np.unique(near[order], return_index=True)
    bounds = np.append(first, len(order))
    for start in range(0, len(sources), _CHUNK):
        chunk = sources[start : start + _CHUNK]
        rows = graph.distances(chunk, limit=limit)
        chosen = order[bounds[start] : bounds[min(start + _CHUNK, len(sources))]]
        distance[chosen] = rows[np.searchsorted(chunk, near[chosen]), far[chosen]]
    errors = []
    for k in known:
        error = np.full(len(predicted), np.nan)
        error[k], distance = distance[: k.sum()], distance[k.sum() :]
        errors.append(error)
    return tuple(errors)


def cumulative_curve(errors: FloatArray, radii: FloatArray) -> FloatArray:
    """Share of the errors that are at most each radius, (r,); NaN counts as larger than any.

    The curve of the Princeton protocol (Kim, Lipman, Funkhouser 2011).
    """
    ordered = np.sort(errors[~np.isnan(errors)])
    return np.searchsorted(ordered, radii, side="right") / max(len(errors), 1)


def area_under_curve(errors: FloatArray, *, largest: float = 0.25) -> float:
    """Mean of the cumulative curve over radii from 0 to `largest`, between 0 and 1."""
    matched = errors[~np.isnan(errors)]
    return float(np.maximum(1 - matched / largest, 0).sum() / max(len(errors), 1))
