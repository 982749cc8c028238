"""How good a statistical shape model is: compactness, generalisation and specificity."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from esd.common import FloatArray

_SAMPLES = 1000  # random shapes by which specificity is measured


@dataclass(frozen=True, slots=True, eq=False)
class ModelQuality:
    """Figures of models with the first 1, 2, … modes, (k,) each; lengths are root mean squares.

    Parameters
    ----------
    compactness
        Share of the variance that is explained.
    generalisation
        Distance of a shape from its best approximation by the modes of all others.
    specificity
        Distance of a random shape of the model from the most similar shape of the population.
    """

    compactness: npt.NDArray[np.float64]
    generalisation: npt.NDArray[np.float64]
    specificity: npt.NDArray[np.float64]


def model_quality(scores: FloatArray, *, count: int, seed: int = 0) -> ModelQuality:
    """Compactness, generalisation and specificity of a model.

    Distances between shapes are root mean squares over the surface, which are those of their
    scores. What was estimated for missing vertices counts as if it was observed.

    Parameters
    ----------
    scores : (s, s - 1) or fewer columns
        Of all shapes, in all modes.
    count
        Up to how many modes the figures are computed.
    seed
        Of the random shapes.

    References
    ----------
    Davies 2002, *Learning shape: optimal models for analysing natural variability* (section 3.3.1).
    """
    scores = np.asarray(scores, dtype=np.float64)
    shapes, width = scores.shape
    variances = scores.var(axis=0, ddof=1)
    compactness = np.cumsum(variances)[:count] / max(variances.sum(), np.finfo(float).tiny)
    missed = np.zeros((shapes, count))
    for i in range(shapes):
        others = np.delete(scores, i, axis=0)
        offset = scores[i] - others.mean(axis=0)
        _, singular, directions = np.linalg.svd(others - others.mean(axis=0), full_matrices=False)
        along = np.where(singular > 1e-9 * max(singular[0], 1e-300), directions @ offset, 0.0) ** 2
        gained = np.zeros(count)
        usable = min(count, len(along))
        gained[:usable] = np.cumsum(along)[:usable]
        gained[usable:] = along.sum()
        missed[i] = np.sqrt(np.maximum((offset**2).sum() - gained, 0.0))
    generator = np.random.default_rng(seed)
    samples = generator.standard_normal((_SAMPLES, width)) * np.sqrt(variances)
    specificity = np.zeros(count)
    for k in range(count):
        random = np.where(np.arange(width) <= k, samples, 0.0)
        squares = (random**2).sum(axis=1)[:, None] + (scores**2).sum(axis=1)
        nearest = (squares - 2 * random @ scores.T).min(axis=1)
        specificity[k] = np.sqrt(np.maximum(nearest, 0.0)).mean()
    return ModelQuality(compactness, missed.mean(axis=0), specificity)


def outliers(distance: FloatArray) -> npt.NDArray[np.bool_]:
    """Whether each shape is farther from the mean than is usual, (s,).

    Beyond the upper quartile by more than one and a half times the distance of the quartiles, as
    `plotOutliers` of the R package geomorph has it for Procrustes distances.

    Parameters
    ----------
    distance : (s,)
        Of each shape from the mean.
    """
    low, high = np.quantile(distance, [0.25, 0.75])
    return np.asarray(distance > high + 1.5 * (high - low))
