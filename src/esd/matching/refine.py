"""Refinement of maps in the spectral domain, by what both shapes' functions say."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from esd.common import FloatArray, InputError, IntArray
from esd.matching.functional_map import functional_map, spectral_rows
from esd.matching.nearest import nearest
from esd.spectral.spectrum import Spectrum

SIZES = (30, 60, 100, 160, 230, 300)
"""Numbers of eigenfunctions, one step after the other."""


def zoomout(
    source: Spectrum,
    target: Spectrum,
    target_index: IntArray,
    *,
    sizes: Sequence[int] = SIZES,
    embeddings: tuple[FloatArray, FloatArray] | None = None,
    weight: float = 0.6,
    bijective: bool = False,
) -> IntArray:
    """The target vertex of each source vertex, (n,), refined with more and more eigenfunctions.

    In each step the map becomes a functional map of that size, and this a map again: that to the
    nearest of the `spectral_rows`. With embeddings, theirs stand beside these rows, so that a
    vertex goes where both agree. Spectral rows alone take shapes for nearly isometric, and spoil a
    good map between shapes that are not; embeddings keep it. The first map must be right about
    left and right: one that is not is made smooth on the wrong side.

    Parameters
    ----------
    target_index : (n,)
        The map to refine; -1 where there is none, which the result fills.
    sizes
        Ascending numbers of eigenfunctions; no more than both shapes have are used.
    embeddings : (n, d) and (m, d), optional
        Of the vertices of the source and the target.
    weight
        Of the embeddings: they are scaled so that two vertices at random are as far apart in them
        as in the spectral rows, times this.
    bijective
        Whether the map back is refined along with the map, each drawing on both, which takes twice
        the time.

    Raises
    ------
    InputError
        If the numbers are not ascending, or the map has no match.

    References
    ----------
    Melzi et al. 2019, *ZoomOut: spectral upsampling for efficient shape correspondence*, for sizes
    alone; Ren et al. 2020, *MapTree: recovering multiple solutions in the space of maps*, for the
    bijective steps.
    """
    if not sizes or list(sizes) != sorted(set(sizes)) or sizes[0] < 1:
        raise InputError(f"`sizes` must be ascending numbers from 1 on; got {tuple(sizes)}.")
    available = min(len(source.eigenvalues), len(target.eigenvalues))
    used = [size for size in sizes if size < available]
    if len(used) < len(sizes):
        used.append(available)
    beside = _scaled(embeddings, weight) if embeddings else None
    back = _backwards(target_index, beside, len(target.mass)) if bijective else None
    index = target_index
    for size in used:
        forward = spectral_rows(source, target, functional_map(source, target, index, size=size))
        if back is None:
            index = _nearest(*_joined([forward], beside, size))
            continue
        backward = spectral_rows(target, source, functional_map(target, source, back, size=size))
        rows, candidates = _joined([forward, backward[::-1]], beside, size)
        index, back = _nearest(rows, candidates), _nearest(candidates, rows)
    return index


def _scaled(
    embeddings: tuple[FloatArray, FloatArray], weight: float
) -> tuple[FloatArray, FloatArray]:
    """The embeddings, with a mean squared distance of two vertices of 2 · weight²."""
    source, target = embeddings
    scale = weight * np.sqrt(2 / mean_squared_distance(source, target))
    return source * scale, target * scale


def mean_squared_distance(source: FloatArray, target: FloatArray) -> float:
    """Mean of the squared distance of any row of one to any row of the other; NaN rows apart."""
    a, b = (rows[np.isfinite(rows).all(axis=1)] for rows in (source, target))
    spread = a.var(axis=0) + b.var(axis=0) + (a.mean(axis=0) - b.mean(axis=0)) ** 2
    return float(spread.sum())


def _backwards(
    target_index: IntArray, beside: tuple[FloatArray, FloatArray] | None, count: int
) -> IntArray:
    """A first map back: to the nearest embedding, or else to the last vertex that is mapped."""
    if beside is not None:
        return nearest(beside[1], beside[0])[0]
    back = np.full(count, -1, dtype=np.int64)
    matched = np.flatnonzero(target_index >= 0)
    back[target_index[matched]] = matched
    return back


def _joined(
    rows: Sequence[tuple[FloatArray, FloatArray]],
    beside: tuple[FloatArray, FloatArray] | None,
    size: int,
) -> tuple[FloatArray, FloatArray]:
    """All rows of the source side by side, and all of the target."""
    parts = list(rows)
    if beside is not None:
        parts.append((beside[0] * np.sqrt(size), beside[1] * np.sqrt(size)))
    source, target = (np.concatenate(side, axis=1) for side in zip(*parts, strict=True))
    return source, target


def _nearest(rows: FloatArray, candidates: FloatArray) -> IntArray:
    # 32 bits are far finer than the rows are accurate, and twice as fast
    return nearest(rows.astype(np.float32), candidates.astype(np.float32))[0]
