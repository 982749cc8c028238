"""Generalised Procrustes alignment of shapes of one connectivity, parts of which may be missing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.linalg import orthogonal_procrustes

from esd.common import FloatArray, InputError
from esd.population.missing import is_present

_ROUNDS = 100
_TOLERANCE = 1e-9  # of the size of the mean: change of the mean that ends the rounds
_FEWEST = 3  # vertices that a shape and the mean must share


@dataclass(frozen=True, slots=True, eq=False)
class Aligned:
    """Shapes in a common position.

    Parameters
    ----------
    vertices : (s, n, 3)
        Of each shape after alignment; NaN where they are missing.
    mean : (n, 3)
        Mean of those that are there; NaN where all are missing.
    sizes : (s,)
        Root mean square distance of each whole shape from its centre, before alignment; where
        parts are missing, by comparison of the others with the mean.
    """

    vertices: npt.NDArray[np.float64]
    mean: npt.NDArray[np.float64]
    sizes: npt.NDArray[np.float64]


def generalised_procrustes(
    vertices: FloatArray,
    *,
    mass: FloatArray,
    start: FloatArray | None = None,
    keep_size: bool = False,
) -> Aligned:
    """Shapes moved, rotated and, if wanted, scaled onto their mean.

    Each vertex counts by its share of the area, so that the result depends little on where a mesh
    has many vertices. Mirror images are not aligned with each other.

    Parameters
    ----------
    vertices : (s, n, 3)
        NaN at missing vertices.
    mass : (n,)
        Weights of the vertices, such as their areas.
    start : (n, 3), optional
        Shape in whose orientation the mean comes to lie; by default the first one.
    keep_size
        Whether shapes are not scaled. If they are, all get the geometric mean of their sizes.

    Raises
    ------
    InputError
        If a shape shares fewer than three vertices with the mean.

    References
    ----------
    Gower 1975, *Generalized Procrustes analysis*. Dryden, Mardia 2016, *Statistical shape
    analysis*, chapter 7.
    """
    shapes = np.asarray(vertices, dtype=np.float64)
    weight = np.asarray(mass, dtype=np.float64) / np.sum(mass)
    present = is_present(shapes)
    mean = shapes[0] if start is None else np.asarray(start, dtype=np.float64)
    mean = mean - _centre(mean, is_present(mean) * weight)
    unit = _size(mean, is_present(mean) * weight)
    scale = np.ones(len(shapes))
    moved = np.full_like(shapes, np.nan)
    for _ in range(_ROUNDS):
        known = is_present(mean)
        for i, shape in enumerate(shapes):
            moved[i], scale[i] = _moved(shape, mean, (present[i] & known) * weight, keep_size)
        before, mean = mean, _mean(moved)
        known = is_present(mean)
        mean = mean - _centre(mean, known * weight)
        if not keep_size:
            mean = mean * unit / _size(mean, known * weight)
        both = known & is_present(before)
        if np.abs(mean - before)[both].max() < _TOLERANCE * unit and (known <= both).all():
            break
    size = _size(mean, known * weight)
    sizes = size / scale
    if not keep_size:
        common = float(np.exp(np.log(sizes).mean()) / size)
        mean, moved = common * mean, common * moved
    return Aligned(moved, mean, sizes)


def aligned_to(
    mean: FloatArray, vertices: FloatArray, *, mass: FloatArray, keep_size: bool = False
) -> npt.NDArray[np.float64]:
    """One shape, (n, 3), moved, rotated and, if wanted, scaled onto a mean.

    Raises
    ------
    InputError
        If they share fewer than three vertices.
    """
    both = is_present(vertices) & is_present(mean)
    centre = _centre(mean, both * mass)
    return _moved(vertices, mean - centre, both * mass, keep_size)[0] + centre


def _moved(
    shape: FloatArray, mean: FloatArray, weight: FloatArray, keep_size: bool
) -> tuple[npt.NDArray[np.float64], float]:
    """A shape on the mean, by the vertices that have weight; size of the mean over its size."""
    used = weight > 0
    if np.count_nonzero(used) < _FEWEST:
        raise InputError(
            f"A shape has {np.count_nonzero(used)} vertices in common with the mean; "
            f"{_FEWEST} or more are needed."
        )
    here, there = _centre(shape, weight), _centre(mean, weight)
    root = np.sqrt(weight[used])[:, None]
    rotation, _ = orthogonal_procrustes(root * (shape[used] - here), root * (mean[used] - there))
    if np.linalg.det(rotation) < 0:  # the best mirror image: the best rotation turns its least axis
        covariance = (root * (shape[used] - here)).T @ (root * (mean[used] - there))
        u, _, vt = np.linalg.svd(covariance)
        rotation = u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt
    ratio = _size(mean - there, weight) / _size(shape - here, weight)
    scale = 1.0 if keep_size else ratio
    return scale * (shape - here) @ rotation + there, float(ratio)


def _mean(shapes: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Mean of the shapes at each vertex, (n, 3), over those that have it; NaN where none has."""
    present = is_present(shapes)
    count = present.sum(axis=0)[:, None]
    total = np.where(present[:, :, None], shapes, 0.0).sum(axis=0)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def _centre(shape: FloatArray, weight: FloatArray) -> npt.NDArray[np.float64]:
    used = weight > 0
    return np.asarray(np.average(shape[used], axis=0, weights=weight[used]))


def _size(centred: FloatArray, weight: FloatArray) -> float:
    """Root mean square distance from the origin."""
    used = weight > 0
    squares = (centred[used] ** 2).sum(axis=1)
    return float(np.sqrt(np.average(squares, weights=weight[used])))
