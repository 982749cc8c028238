"""Noise in position and connectivity: how the error of each descriptor grows with it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from esd.common import FloatArray, InputError, IntArray
from esd.datasets.collection import Shape
from esd.evaluation.errors import geodesic_errors
from esd.evaluation.perturb import PERTURBATIONS
from esd.learning.model import Model
from esd.matching.match import match
from esd.mesh.doctor import Repaired, repair
from esd.mesh.geodesics import geodesic_diameter, geodesic_graph
from esd.mesh.mesh import Mesh
from esd.spectral.cache import Cache


@dataclass(frozen=True, slots=True, eq=False)
class NoisyPair:
    """A disturbed shape mapped to a clean one by one model.

    Parameters
    ----------
    noise, level
        Of `PERTURBATIONS`; the level 0 is the clean shape.
    model, source, target
        Names.
    mean_error
        Mean over the points that both shapes have, as a share of the target's diameter; to the
        nearer of the true and the mirrored vertex where both are known.
    precision, recall
        Of 'the vertex has a counterpart' where the source is clean and the target is disturbed,
        by confidence above the model's rejection threshold; NaN where nothing is missing, or the
        model has no threshold.
    mesh
        The disturbed shape.
    errors : (n,)
        At its vertices, as shares of the diameter; NaN where unknown.
    """

    noise: str
    level: float
    model: str
    source: str
    target: str
    mean_error: float
    precision: float
    recall: float
    mesh: Mesh
    errors: FloatArray


def noise(
    pairs: Sequence[tuple[Shape, Shape]],
    models: Sequence[Model],
    *,
    levels: int | None = None,
    seed: int = 0,
    cache: Cache | None = None,
) -> tuple[NoisyPair, ...]:
    """Errors of the maps from disturbed shapes to clean ones, for each noise, level and model.

    Each source is disturbed and repaired as `match` does unasked.

    Parameters
    ----------
    levels
        How many levels of each noise are measured, the mildest first; all by default.
    seed
        Of the noise.

    Raises
    ------
    InputError
        If there are no pairs.
    """
    if not pairs:
        raise InputError("The noise study needs at least one pair of shapes.")
    return tuple(
        _measured(name, level, model, source, target, seed=seed, cache=cache)
        for name, kind in PERTURBATIONS.items()
        for level in (0.0, *kind.levels[:levels])
        for source, target in pairs
        for model in models
    )


def _measured(
    name: str,
    level: float,
    model: Model,
    source: Shape,
    target: Shape,
    *,
    seed: int,
    cache: Cache | None,
) -> NoisyPair:
    disturbed = PERTURBATIONS[name].disturb(source.mesh(), level, seed=seed)
    clean, sound = target.mesh(), repair(disturbed.mesh)
    graph = geodesic_graph(clean)
    here = source.correspondence()
    there = np.where(here >= 0, disturbed.vertex_index[here], -1)
    found = match(sound, clean, model=model, cache=cache)
    predicted = np.where(there >= 0, found.target_index[there], -1)
    truths = [target.correspondence()]
    if target.symmetric is not None:
        truths.append(target.symmetric())
    error = np.fmin.reduce(geodesic_errors(graph, predicted, tuple(truths)))
    error = error / geodesic_diameter(clean, graph=graph)
    painted = np.full(len(disturbed.mesh.vertices), np.nan)
    painted[there[there >= 0]] = error[there >= 0]
    backward = _counterparts(model, clean, sound, truths[0], there, cache)
    known = error[np.isfinite(error)]
    mean = float(known.mean()) if len(known) else float("nan")
    return NoisyPair(
        name, level, model.name, source.name, target.name, mean, *backward, disturbed.mesh, painted
    )


def _counterparts(
    model: Model,
    clean: Mesh,
    sound: Repaired,
    at_clean: IntArray,
    there: IntArray,
    cache: Cache | None,
) -> tuple[float, float]:
    """Precision and recall of 'has a counterpart', from the clean shape to the disturbed one."""
    known = at_clean >= 0
    has = there[known] >= 0
    if model.margin is None or has.all():
        return float("nan"), float("nan")
    back = match(clean, sound, model=model, cache=cache).rejecting(model.threshold())
    says = back.is_matched()[at_clean[known]]
    right = int((says & has).sum())
    return right / max(int(says.sum()), 1), right / max(int(has.sum()), 1)
