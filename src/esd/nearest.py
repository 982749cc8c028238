"""Exact nearest neighbours of descriptors."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np

from esd.common import FloatArray, InputError, IntArray

_TREE_WIDTH = 20  # beyond this dimension a tree visits nearly everything
_TILE = 2048, 4096  # rows of either side whose products are computed at once
_CHUNK_BYTES = 2**26
_CHUNK_ROWS = 256  # at least, below which products of matrices become slow


def nearest(
    source: FloatArray, target: FloatArray, *, device: str = "cpu"
) -> tuple[IntArray, FloatArray]:
    """Index (n,) of the nearest row of `target` to each row of `source`, and the distance (n,).

    Rows that are not finite take no part: such a row of `source` has index -1, distance infinite.

    Parameters
    ----------
    device
        Where it is computed, see `esd.learning.model.Model`.

    Raises
    ------
    InputError
        If the rows differ in length, or no row of `target` is finite.
    """
    if source.ndim != 2 or target.ndim != 2 or source.shape[1] != target.shape[1]:
        raise InputError(f"Rows must be equally long; got {source.shape} and {target.shape}.")
    defined = np.isfinite(source).all(axis=1)
    candidates = np.flatnonzero(np.isfinite(target).all(axis=1))
    if len(candidates) == 0:
        raise InputError("The target has no vertex with a finite descriptor.")
    rows = source[defined], target[candidates]
    if device == "cpu" and source.shape[1] <= _TREE_WIDTH:
        found, reach = _by_tree(*rows)
    else:
        found, reach = _by_products(*rows, device)
    index = np.full(len(source), -1, dtype=np.int64)
    distance = np.full(len(source), np.inf)
    index[defined], distance[defined] = candidates[found], reach
    return index, distance


def _by_tree(source: FloatArray, target: FloatArray) -> tuple[IntArray, FloatArray]:
    from scipy.spatial import KDTree  # slow to import, and only needed for short rows

    distance, index = KDTree(target).query(source, workers=-1)
    return np.asarray(index, dtype=np.int64), distance


def _by_products(
    source: FloatArray, target: FloatArray, device: str
) -> tuple[IntArray, FloatArray]:
    """By |s − t|² = |s|² − 2 (s·t − |t|² / 2), centred, so that little cancels."""
    centre = target.mean(axis=0)
    # one column more, so that a product of matrices gives all of the bracket
    a, b = _with_ones(source, centre), _with_ones(target, centre)
    b[:, -1] = -np.einsum("ij,ij->i", b[:, :-1], b[:, :-1]) / 2
    index = _largest(a, b) if device == "cpu" else _largest_by_torch(a, b, device)
    distance = np.empty(len(source))
    for part in _parts(len(source), a.shape[1]):
        distance[part] = np.linalg.norm((a[part] - b[index[part]])[:, :-1], axis=1)
    return index, distance


def _largest(a: FloatArray, b: FloatArray) -> IntArray:
    """The row of b that has the largest product with each row of a, (n,).

    By tiles that stay in the cache of the processor, and in the same piece of memory.
    """
    index = np.zeros(len(a), dtype=np.int64)
    space = np.empty(_TILE[0] * _TILE[1], dtype=a.dtype)
    for start in range(0, len(a), _TILE[0]):
        rows = a[start : start + _TILE[0]]
        best, every = np.full(len(rows), -np.inf, dtype=a.dtype), np.arange(len(rows))
        for first in range(0, len(b), _TILE[1]):
            columns = b[first : first + _TILE[1]]
            tile = space[: len(rows) * len(columns)].reshape(len(rows), len(columns))
            which = np.matmul(rows, columns.T, out=tile).argmax(axis=1)
            found = tile[every, which]
            better = found > best
            best[better] = found[better]
            index[start + every[better]] = first + which[better]
    return index


def _largest_by_torch(a: FloatArray, b: FloatArray, device: str) -> IntArray:
    """As `_largest`, by torch."""
    import torch

    rows, columns = (torch.from_numpy(array).to(device) for array in (a, b))
    return np.concatenate(
        [(rows[part] @ columns.T).argmax(dim=1).cpu().numpy() for part in _parts(len(a), len(b))]
    )


def _with_ones(rows: FloatArray, centre: FloatArray) -> FloatArray:
    """Rows less their centre, and a column of ones."""
    result = np.ones((len(rows), len(centre) + 1), dtype=rows.dtype)
    np.subtract(rows, centre, out=result[:, :-1])
    return result


def nearest_within(
    source: FloatArray,
    target: FloatArray,
    groups: IntArray,
    cells: IntArray,
    reach: Sequence[IntArray],
) -> tuple[IntArray, int]:
    """Index (n,) of the nearest row of `target` among those that each row's group may go to.

    Where rows near each other in some other respect are in one group, this takes a small share of
    the products of `nearest`, and time linear in the number of rows.

    Parameters
    ----------
    groups : (n,)
        Of each row of `source`, from 0.
    cells : (m,)
        Of each row of `target`, from 0.
    reach : for each group (c,)
        The cells that its rows may go to.

    Returns
    -------
    index, products
        -1 for rows that are not finite or find nothing; how many products of two rows were taken.
    """
    usable = np.flatnonzero(np.isfinite(source).all(axis=1))
    candidates = np.flatnonzero(np.isfinite(target).all(axis=1))
    members = _members(groups[usable], len(reach))
    # the last cells may have no rows: of samples at one place only one is nearest to any
    known = max((int(wanted.max()) + 1 for wanted in reach if len(wanted)), default=0)
    held = _members(cells[candidates], known)
    halves = np.einsum("ij,ij->i", target, target) / 2
    index = np.full(len(source), -1, dtype=np.int64)
    products = 0
    for rows, wanted in zip(members, reach, strict=True):
        if len(rows) == 0 or len(wanted) == 0:
            continue
        there = candidates[np.concatenate([held[cell] for cell in wanted])]
        if len(there) == 0:
            continue
        here = usable[rows]
        # |s - t|² is least where s·t - |t|² / 2 is largest
        index[here] = there[(source[here] @ target[there].T - halves[there]).argmax(axis=1)]
        products += len(here) * len(there)
    return index, products


def _members(labels: IntArray, count: int) -> list[IntArray]:
    """The places at which each label, from 0 to count − 1, is."""
    order = np.argsort(labels, kind="stable")
    bounds = np.searchsorted(labels[order], np.arange(count + 1)).tolist()
    return [order[start:stop] for start, stop in pairwise(bounds)]


def nearest_candidates(
    source: FloatArray, target: FloatArray, *, count: int
) -> tuple[FloatArray, IntArray]:
    """Squared distances and indices, (n, count) each, of some nearest rows, in no order.

    All rows must be finite, and `count` no more than those of `target`.
    """
    centre = target.mean(axis=0)
    source, target = source - centre, target - centre
    squares = np.einsum("ij,ij->i", target, target)
    index = np.empty((len(source), count), dtype=np.int64)
    for part in _parts(len(source), len(target)):
        index[part] = np.argpartition(squares - 2 * source[part] @ target.T, count - 1)[:, :count]
    gap = source[:, None] - target[index]
    return np.einsum("ikd,ikd->ik", gap, gap), index


def _parts(count: int, width: int) -> Iterator[slice]:
    """Parts of a number of rows, such that a matrix of this width has a bounded size."""
    rows = max(_CHUNK_ROWS, _CHUNK_BYTES // (8 * width))
    return (slice(start, start + rows) for start in range(0, count, rows))
