"""Maps in which no target vertex is taken twice."""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import min_weight_full_bipartite_matching

from esd.common import FloatArray, InputError, IntArray
from esd.nearest import nearest_candidates


def one_to_one(source: FloatArray, target: FloatArray, *, candidates: int = 30) -> IntArray:
    """The target vertex of each source vertex, (n,), none of them twice; -1 for those left out.

    The assignment with the smallest sum of squared distances, of each source vertex to one of its
    nearest rows of the target or to none, which costs as much as the farthest candidate of all.
    There are as many matches as that allows, and no more than the smaller shape has vertices.

    Parameters
    ----------
    source, target : (n, d) and (m, d)
        Embeddings, or `esd.matching.refine.joint_rows`. Rows that are not finite take no part.
    candidates
        Number of nearest target rows that each source row may be assigned to.

    Raises
    ------
    InputError
        If the rows differ in length, or there are no finite ones.

    References
    ----------
    Jonker, Volgenant 1987, *A shortest augmenting path algorithm for dense and sparse linear
    assignment problems*; LAPJVsp in SciPy.
    """
    if source.ndim != 2 or target.ndim != 2 or source.shape[1] != target.shape[1]:
        raise InputError(f"Rows must be equally long; got {source.shape} and {target.shape}.")
    here, there = (np.flatnonzero(np.isfinite(rows).all(axis=1)) for rows in (source, target))
    if len(here) == 0 or len(there) == 0:
        raise InputError("No vertex has a finite row.")
    count = min(candidates, len(there))
    squared, near = nearest_candidates(source[here], target[there], count=count)
    none = float(squared.max())
    # each source vertex has a column of its own that means no match; weights must not be 0
    columns = np.concatenate([near, len(there) + np.arange(len(here))[:, None]], axis=1)
    cost = np.concatenate([squared, np.full((len(here), 1), none)], axis=1) + 1e-6 * none + 1e-300
    rows = np.repeat(np.arange(len(here)), count + 1)
    graph = sparse.coo_array(
        (cost.ravel(), (rows, columns.ravel())), shape=(len(here), len(there) + len(here))
    ).tocsr()
    assigned_rows, assigned = min_weight_full_bipartite_matching(graph)
    result = np.full(len(source), -1, dtype=np.int64)
    taken = assigned < len(there)
    result[here[assigned_rows[taken]]] = there[assigned[taken]]
    return result
