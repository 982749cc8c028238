"""Refinement of maps in the spectral domain, by what both shapes' functions say."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from esd.common import FloatArray, InputError, IntArray
from esd.matching.functional_map import fitted_map, functional_map, spectral_rows
from esd.nearest import nearest
from esd.spectral.spectrum import Spectrum

SIZES = (30, 60, 100, 160, 230, 300)
"""Numbers of eigenfunctions, one step after the other."""

LEAST_WEIGHT, LARGEST_WEIGHT = 0.5, 1.2
"""Of embeddings beside eigenfunctions, between isometric shapes and very different ones."""

_ROWS = 10_000
_WEIGHT_OF_MISFIT = 5.0  # people have misfits of 0.07 to 0.11, animals of 0.13 to 6


def zoomout(
    source: Spectrum,
    target: Spectrum,
    target_index: IntArray,
    *,
    sizes: Sequence[int] = SIZES,
    embeddings: tuple[FloatArray, FloatArray] | None = None,
    weight: float | None = None,
    bijective: bool = False,
    sampled: bool = False,
    device: str = "cpu",
) -> IntArray:
    """The target vertex of each source vertex, (n,), refined with more and more eigenfunctions.

    In each step the map becomes a functional map of that size, and this a map again: that to the
    nearest of the `spectral_rows`. With embeddings, theirs are beside these rows, so that a
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
        Of the embeddings: matched vertices are as far apart in them as in the spectral rows, times
        this. So either counts the less the worse it fits the map. By default the more, the less
        the first map is an isometry: five times the mean squared distance of matched spectral
        rows of the smallest size, a component, within `LEAST_WEIGHT` and `LARGEST_WEIGHT`.
    bijective
        Whether the map back is refined along with the map, each drawing on both, which takes twice
        the time.
    sampled
        Whether the spectra have samples of the vertices, see
        `esd.matching.functional_map.fitted_map`.
    device
        Where nearest rows are found, see `esd.learning.model.Model`.

    Raises
    ------
    InputError
        If the numbers are not ascending, or the map is none between the shapes or has no match.

    References
    ----------
    Melzi et al. 2019, *ZoomOut: spectral upsampling for efficient shape correspondence*, for sizes
    alone; Ren et al. 2020, *MapTree: recovering multiple solutions in the space of maps*, for the
    bijective steps.
    """
    used = usable_sizes(sizes, source, target)
    if np.shape(target_index) != np.shape(source.mass):
        raise InputError(
            "`target_index` must hold a vertex of the target, or -1, for each vertex of the "
            f"source, ({len(source.mass)},); got shape {np.shape(target_index)}."
        )
    index, back = target_index, _backwards(target_index, len(target.mass))
    mapped = fitted_map if sampled else functional_map
    if weight is None:
        weight = isometry_weight(source, target, mapped(source, target, index, size=used[0]), index)
    for size in used:
        functional = mapped(source, target, index, size=size)
        rows = joined(source, target, functional, index, embeddings=embeddings, weight=weight)
        if bijective:
            functional = mapped(target, source, back, size=size)
            rows = side_by_side_rows(rows, spectral_rows(target, source, functional)[::-1], 1.0)
        index, _ = nearest(*rows, device=device)
        if bijective:
            back, _ = nearest(*rows[::-1], device=device)
    return index


def usable_sizes(sizes: Sequence[int], source: Spectrum, target: Spectrum) -> list[int]:
    """The numbers of eigenfunctions that both shapes have, or all that they have for larger ones.

    Raises
    ------
    InputError
        If the numbers are not ascending.
    """
    if not sizes or list(sizes) != sorted(set(sizes)) or sizes[0] < 1:
        raise InputError(f"`sizes` must be ascending numbers from 1 on; got {tuple(sizes)}.")
    available = min(len(source.eigenvalues), len(target.eigenvalues))
    used = [size for size in sizes if size < available]
    return used if len(used) == len(sizes) else [*used, available]


def isometry_weight(
    source: Spectrum, target: Spectrum, functional: FloatArray, target_index: IntArray
) -> float:
    """The default weight of embeddings in `zoomout`, by how well a functional map fits a map."""
    rows = spectral_rows(source, target, functional)
    misfit = _residual(*rows, target_index) ** 2 / len(functional)
    return float(np.clip(_WEIGHT_OF_MISFIT * misfit, LEAST_WEIGHT, LARGEST_WEIGHT))


def joint_rows(
    source: Spectrum,
    target: Spectrum,
    target_index: IntArray,
    *,
    size: int,
    embeddings: tuple[FloatArray, FloatArray] | None = None,
    weight: float = LEAST_WEIGHT,
) -> tuple[FloatArray, FloatArray]:
    """Rows of the vertices of both shapes that are close where a map and its embeddings agree.

    See `joined`, with the map's functional map of a size, and `zoomout` for the parameters.
    """
    functional = functional_map(source, target, target_index, size=size)
    return joined(source, target, functional, target_index, embeddings=embeddings, weight=weight)


def joined(
    source: Spectrum,
    target: Spectrum,
    functional: FloatArray,
    target_index: IntArray,
    *,
    embeddings: tuple[FloatArray, FloatArray] | None,
    weight: float,
) -> tuple[FloatArray, FloatArray]:
    """The `spectral_rows` of a functional map, and embeddings beside them.

    In 32 bits, which are far finer than the rows are accurate, and take half the time and memory.
    NaN at vertices without a face. See `zoomout` for the weight.
    """
    rows = spectral_rows(source, target, functional)
    if embeddings is None:
        return rows[0].astype(np.float32), rows[1].astype(np.float32)
    return side_by_side_rows(rows, embeddings, scale_beside(rows, embeddings, target_index, weight))


def scale_beside(
    rows: tuple[FloatArray, FloatArray],
    embeddings: tuple[FloatArray, FloatArray],
    target_index: IntArray,
    weight: float,
) -> float:
    """The factor of embeddings beside spectral rows, by how far matched vertices are in both."""
    least = 1e-3 * np.sqrt(mean_squared_distance(*embeddings))
    gap = max(_residual(*embeddings, target_index), least)
    return weight * _residual(*rows, target_index) / gap


def mean_squared_distance(source: FloatArray, target: FloatArray) -> float:
    """Mean of the squared distance of any row of one to any row of the other; NaN rows apart."""
    a, b = (rows[np.isfinite(rows).all(axis=1)] for rows in (source, target))
    spread = a.var(axis=0) + b.var(axis=0) + (a.mean(axis=0) - b.mean(axis=0)) ** 2
    return float(spread.sum())


def _backwards(target_index: IntArray, count: int) -> IntArray:
    """For each target vertex the last source vertex that is mapped to it, or -1."""
    back = np.full(count, -1, dtype=np.int64)
    matched = np.flatnonzero(target_index >= 0)
    back[target_index[matched]] = matched
    return back


def _residual(source: FloatArray, target: FloatArray, target_index: IntArray) -> float:
    """Root mean squared distance of the rows that are matched."""
    matched = np.flatnonzero(target_index >= 0)
    squares = [  # of some at a time, since rows of dense meshes are large
        ((source[part] - target[target_index[part]]) ** 2).sum(axis=1)
        for part in np.array_split(matched, len(matched) // _ROWS + 1)
    ]
    return float(np.sqrt(np.nanmean(np.concatenate(squares))))


def side_by_side_rows(
    first: tuple[FloatArray, FloatArray], second: tuple[FloatArray, FloatArray], scale: float
) -> tuple[FloatArray, FloatArray]:
    """Rows of the source, and of the target, of both kinds; the second times a scale."""
    source, target = (
        np.hstack([a.astype(np.float32), (scale * b).astype(np.float32)])
        for a, b in zip(first, second, strict=True)
    )
    return source, target
