"""Refinement of maps in time linear in the number of vertices: samples first, then nearby."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.spatial import KDTree

from esd.common import FloatArray, InputError, IntArray
from esd.matching.functional_map import fitted_map, functional_map, spectral_rows
from esd.matching.refine import (
    LEAST_WEIGHT,
    SIZES,
    isometry_weight,
    scale_beside,
    side_by_side_rows,
    usable_sizes,
    zoomout,
)
from esd.nearest import nearest, nearest_within
from esd.spectral.spectrum import Spectrum

_SAMPLES = 2000  # vertices of the first level
_GROWTH = 4  # of the number of vertices from one level of samples to the next
_SAMPLED = 60  # eigenfunctions up to which samples are enough
_ISOMETRIC_SAMPLED = 30  # the same between isometric shapes, whose maps can be more exact
_GROUP = 16  # samples of the source that are searched for together
_AROUND = 12  # samples of the target, nearest to a match, around which it is searched


@dataclass(frozen=True, slots=True, eq=False)
class Level:
    """Some vertices of a shape, and the samples of the level before near them.

    Parameters
    ----------
    vertices : (v,)
        Of the shape.
    spectrum
        At these vertices, for unit area, its functions in 32 bits.
    cells : (v,)
        The nearest sample of the level before, by its place there.
    groups : (v,)
        The group of neighbouring samples which that sample is in.
    around : (s, c)
        For each sample of the level before, those nearest to it.
    """

    vertices: IntArray
    spectrum: Spectrum
    cells: IntArray
    groups: IntArray
    around: IntArray


def levels(
    spectrum: Spectrum, positions: FloatArray, *, count: int, seed: int = 0
) -> tuple[Level, ...]:
    """More and more vertices of a shape: two thousand samples first, all with a face last.

    Samples are drawn by area; each level of them is the start of the next.

    Parameters
    ----------
    positions : (n, 3)
        Of the vertices.
    count
        Vertices of the larger one of two shapes: both have as many levels.
    """
    spectrum = spectrum.with_area(1.0)
    used = np.flatnonzero(spectrum.mass > 0)
    sizes = [_SAMPLES]
    while sizes[-1] * _GROWTH**2 < count:
        sizes.append(sizes[-1] * _GROWTH)
    order = np.random.default_rng(seed).choice(
        used, min(sizes[-1], len(used)), replace=False, p=spectrum.mass[used] / spectrum.mass.sum()
    )
    vertices = [*(order[:size] for size in sizes), used]
    spectra = [_at(spectrum, some, is_all=len(some) == len(used)) for some in vertices]
    nobody = np.zeros(0, dtype=np.int64)
    found = [Level(vertices[0], spectra[0], nobody, nobody, nobody[:, None])]
    for (before, after), at in zip(pairwise(vertices), spectra[1:], strict=True):
        samples = positions[before]
        tree = KDTree(samples)
        cells = tree.query(positions[after])[1]
        around = tree.query(samples, k=min(_AROUND, len(samples)))[1].reshape(len(samples), -1)
        # the first samples are drawn by area as all are: centres of groups
        groups = KDTree(samples[: -(-len(samples) // _GROUP)]).query(samples)[1]
        found.append(Level(after, at, cells, groups[cells], around))
    return tuple(found)


def _at(spectrum: Spectrum, vertices: IntArray, *, is_all: bool) -> Spectrum:
    """The spectrum at vertices drawn by area, each of which has the same share of it, or at all."""
    count = len(vertices)
    return replace(
        spectrum,
        eigenvectors=spectrum.eigenvectors[vertices].astype(np.float32),
        mass=spectrum.mass[vertices] if is_all else np.full(count, 1 / count),
    )


def local_zoomout(
    source: Sequence[Level],
    target: Sequence[Level],
    rows: tuple[FloatArray, FloatArray],
    *,
    embeddings: tuple[FloatArray, FloatArray],
    sizes: Sequence[int] = SIZES,
) -> tuple[IntArray, int]:
    """The target vertex of each source vertex, (n,), as by `zoomout`, in far less time.

    The first steps refine a map between samples, which determine a functional map of few
    functions as well as all vertices do. The last steps see all vertices, and search around the
    match of the nearest sample only. Of dense meshes there are levels between, so that time is
    linear in the number of vertices.

    Parameters
    ----------
    source, target
        The `levels` of both shapes, of the same count.
    rows : (n, d) and (m, d)
        The map to refine goes to the nearest of these.
    embeddings, sizes
        See `zoomout`.

    Returns
    -------
    index, products
        The map, -1 for vertices without a face; how many products of two rows it took.

    Raises
    ------
    InputError
        If the numbers are not ascending, or the shapes have different levels.
    """
    if len(source) != len(target):
        raise InputError(f"Both shapes need as many levels; got {len(source)} and {len(target)}.")
    here, there = source[0], target[0]
    used = usable_sizes(sizes, here.spectrum, there.spectrum)
    at_samples = embeddings[0][here.vertices], embeddings[1][there.vertices]
    index, _ = nearest(rows[0][here.vertices], rows[1][there.vertices])
    spectra = here.spectrum, there.spectrum
    weight = isometry_weight(*spectra, fitted_map(*spectra, index, size=used[0]), index)
    enough = _SAMPLED if weight > LEAST_WEIGHT else _ISOMETRIC_SAMPLED
    few = [size for size in used if size <= enough] or used[:1]
    many = used[len(few) :] or used[-1:]
    index = zoomout(*spectra, index, sizes=few, embeddings=at_samples, weight=weight, sampled=True)
    products = (len(few) + 1) * len(here.vertices) * len(there.vertices)
    for number in range(1, len(source)):
        is_last = number == len(source) - 1
        for step, size in enumerate(many if is_last else many[:1]):
            # by the samples of the level before, and then by the vertices of this one
            mapped = functional_map if step else fitted_map
            functional = mapped(*spectra, index, size=size)
            scale = scale_beside(spectral_rows(*spectra, functional), at_samples, index, weight)
            if step:
                cells = there.cells[index]
            else:
                here, there = source[number], target[number]
                spectra = here.spectrum, there.spectrum
                at_samples = embeddings[0][here.vertices], embeddings[1][there.vertices]
                cells = index[here.cells]
            joint = side_by_side_rows(spectral_rows(*spectra, functional), at_samples, scale)
            index, taken = nearest_within(
                *joint, here.groups, there.cells, _reach(here.groups, cells, there.around)
            )
            products += taken
    result = np.full(len(rows[0]), -1, dtype=np.int64)
    result[here.vertices] = np.where(index >= 0, there.vertices[index], -1)
    return result, products


def _reach(groups: IntArray, cells: IntArray, around: IntArray) -> list[IntArray]:
    """For each group the cells around those that its vertices lead to."""
    count = int(groups.max()) + 1
    # one number for a group and a cell; a vertex without a match leads to cell -1, as the last
    pairs = np.unique(groups * len(around) + cells % len(around))
    bounds = np.searchsorted(pairs // len(around), np.arange(count + 1)).tolist()
    return [np.unique(around[pairs[a:b] % len(around)]) for a, b in pairwise(bounds)]
