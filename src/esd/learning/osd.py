"""Optimal spectral descriptors: the linear map in which points tell best what corresponds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.linalg import eigh

from esd.common import FloatArray, InputError
from esd.datasets.collection import Collection
from esd.descriptors.recipe import Recipe, recipe_spectrum
from esd.spectral.cache import Cache

_RIDGE = 1e-3
_KNOT_SHARE = 99  # percent of the training eigenvalues that lie below the last knot


def optimal_metric(
    corresponding: FloatArray, other: FloatArray, outputs: int, *, ridge: float = _RIDGE
) -> FloatArray:
    """The linear map A (outputs, d) of optimal spectral descriptors, in closed form.

    Its rows a are the directions in which points that correspond differ least, relative to those
    that do not: C₊ a = μ C₋ a for the smallest μ, with C± the means of d dᵀ over the differences d
    of both kinds. They are scaled so that A C₊ Aᵀ = I: each direction counts by how much more
    others differ in it, 1 / μ. (Scaled so that A C₋ Aᵀ = I, directions that tell nothing, with μ
    near one, would count as much as the best, and a map with more outputs could be worse.)

    Parameters
    ----------
    corresponding, other : (p, d), (r, d)
        Differences between descriptors of points that correspond, and of points that do not.
    ridge
        ε: this share of the mean of the diagonal of C₋ is added to both diagonals, since spectral
        descriptors are nearly dependent on each other. Directions in which neither kind differs by
        more have μ near one, and so come last.

    Raises
    ------
    InputError
        If there are fewer than one or more than d outputs.

    References
    ----------
    Litman, Bronstein 2014, *Learning spectral descriptors for deformable shape correspondence*;
    as a ratio, without a weight between both kinds.
    """
    width = corresponding.shape[1]
    if not 1 <= outputs <= width:
        raise InputError(f"`outputs` must be from 1 to {width}, the descriptors; got {outputs}.")
    near, far = (d.T @ d / len(d) for d in (corresponding, other))
    added = ridge * np.trace(far) / width * np.eye(width)
    ratios, vectors = eigh(near + added, far + added, subset_by_index=(0, outputs - 1))
    return np.asarray((vectors / np.sqrt(ratios)).T)


def with_knots(recipe: Recipe, collection: Collection, *, cache: Cache | None = None) -> Recipe:
    """The recipe with the knots of its geometry vectors spread over the collection's eigenvalues.

    They end at the 99th percentile; a recipe that has none, or says where they end, stays as it is.
    """
    open_parts = [
        part.kind == "geometry" and "largest" not in part.options for part in recipe.descriptors
    ]
    if not any(open_parts):
        return recipe
    eigenvalues = [
        recipe_spectrum(recipe, shape.mesh(), cache=cache).eigenvalues
        for shape in collection.shapes
    ]
    largest = float(np.percentile(np.concatenate(eigenvalues), _KNOT_SHARE))
    return replace(
        recipe,
        descriptors=tuple(
            replace(part, options={**part.options, "largest": largest}) if is_open else part
            for part, is_open in zip(recipe.descriptors, open_parts, strict=True)
        ),
    )
