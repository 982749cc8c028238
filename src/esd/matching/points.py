"""What is to be expected of maps between points without faces, by triangles between neighbours."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from esd.common import IntArray
from esd.matching.candidates import candidate_of, pair_descriptors, sampled
from esd.matching.features import Features
from esd.matching.judge import Evidence, evidence
from esd.mesh.cloud import surface_between
from esd.mesh.mesh import PointCloud

# of `Evidence.vector`; none of what depends on the model, or on positions, by which no map of
# points is found: benchmarks/points.py
_WEIGHTS = (
    *(1.157, -0.87, -1.76, 0.368, 0.0, 2.196, -0.04, 0.0, 0.0, 0.0),
    *(0.0, 0.0, -1.192, 0.0, -1.021),
)
_CONSTANT = -2.02


def with_surface(features: Features) -> Features:
    """The features of points with a surface between these; those of a mesh as they are.

    Raises
    ------
    InputError
        If no surface can be seen between the points.
    """
    shape = features.shape
    if not isinstance(shape, PointCloud):
        return features
    return replace(features, shape=surface_between(shape))


def evidence_of_points(
    source: Features, target: Features, target_index: IntArray, source_index: IntArray
) -> Evidence:
    """The evidence for a map between shapes `with_surface`, and one back, (n,) and (m,)."""
    shapes = sampled(source), sampled(target)
    candidate = candidate_of(*shapes, target_index, source_index)
    return evidence(*shapes, candidate, pair_descriptors(*shapes))


def accuracy_of_points(found: Evidence) -> float:
    """Expected share of matches within 5 % of the diameter of the truth, by a logistic regression.

    Fitted to right and wrong maps between the vertices of people, see `benchmarks/points.py`.
    """
    logit = float(found.vector() @ np.array(_WEIGHTS)) + _CONSTANT
    return float(1 / (1 + np.exp(-logit)))
