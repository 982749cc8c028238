"""Intrinsic dimension of descriptors, by principal components of neighbourhoods."""

from __future__ import annotations

import numpy as np

from esd.common import FloatArray, InputError, IntArray

_CHUNK = 256


def nearest_neighbours(values: FloatArray, places: IntArray, *, count: int) -> IntArray:
    """The rows nearest to some rows, themselves left out, nearest first, (places, count).

    Raises
    ------
    InputError
        If there are not more rows than `count`.
    """
    if not 1 <= count < len(values):
        raise InputError(f"`count` must be from 1 to {len(values) - 1}; got {count}.")
    centred = values - values.mean(axis=0)
    half_squares = np.einsum("ij,ij->i", centred, centred) / 2
    found = []
    for start in range(0, len(places), _CHUNK):
        chunk = places[start : start + _CHUNK]
        distance = half_squares - centred[chunk] @ centred.T  # half the square, less a constant
        distance[np.arange(len(chunk)), chunk] = np.inf
        near = np.argpartition(distance, count - 1, axis=1)[:, :count]
        order = np.argsort(np.take_along_axis(distance, near, axis=1), axis=1)
        found.append(np.take_along_axis(near, order, axis=1))
    return np.concatenate(found)


def residual_variances(values: FloatArray, neighbours: IntArray) -> FloatArray:
    """Share of each neighbourhood's variance beyond 0, 1, … principal components, (p, k).

    Local principal component analysis (section 3.3 of the paper). k points span k − 1 dimensions
    at the most, so nothing can be left after k − 1 components, whatever the data.

    Parameters
    ----------
    values : (n, d)
        Descriptors.
    neighbours : (p, k)
        Rows of each neighbourhood.
    """
    points = values[neighbours]
    points = points - points.mean(axis=1, keepdims=True)
    variances = np.linalg.eigvalsh(points @ points.transpose(0, 2, 1))[:, ::-1].clip(min=0)
    total = variances.sum(axis=1, keepdims=True)
    covered = np.cumsum(variances, axis=1) / np.where(total > 0, total, 1)
    return np.concatenate([np.ones((len(points), 1)), 1 - covered[:, :-1]], axis=1)


def components_needed(residuals: FloatArray, *, share: float = 0.99) -> IntArray:
    """Number of principal components that cover a share of the variance, (p,).

    Parameters
    ----------
    residuals : (p, k)
        See `residual_variances`.
    """
    rounding = 1e-12
    return (residuals > 1 - share + rounding).sum(axis=1)
