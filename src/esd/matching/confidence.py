"""How far a map can be trusted: for each vertex, and for the pair."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal, TypeAlias

import numpy as np
from scipy import sparse

from esd.common import BoolArray, FloatArray, IntArray
from esd.mesh.geometry import (
    adjacency,
    edges,
    face_areas,
    is_referenced,
    surface_area,
    vertex_normals,
)
from esd.mesh.mesh import Mesh

Verdict: TypeAlias = Literal["good", "doubtful", "failed", "mirrored"]

_OFFSET = 0.01  # added to lengths over √area before the logarithm; about half of an edge
_LOGISTIC = (-5.33, -1.47, -0.82)  # constant, and factors of the two logarithms of `evidence`
_JUDGED = (-7.436, -1.058, -0.858, 0.999)  # and the factor of the logit of the accuracy
_ORIENTED = 0.3  # orientation that a map needs to be good; of mirrored ones below the negative
_WORTH_SAYING = 0.01  # share of a shape that is unmatched
_SAME_UNIT = 0.25  # logarithm of a ratio of lengths within which one unit is taken: people differ
_GOOD, _FAILED = 0.9, 0.5  # expected shares of vertices within 5 % of the diameter

ADVICE = {
    "good": "",
    "doubtful": "Parts of the map are wrong; look at the confidence of each vertex.",
    "failed": "The map is not to be trusted: the shapes differ too much, or too much is missing.",
    "mirrored": "The map is orientation-reversing: one of the meshes is inside out, or its "
    "coordinates are a mirror image. If they are, left and right are exchanged.",
}
"""What to do about each verdict."""


@dataclass(frozen=True, slots=True)
class Adaptation:
    """What adapting a model to a pair of shapes cost and gave.

    Parameters
    ----------
    seconds
        That it took.
    cost_before, cost_after
        Of the best candidate by the model and by the adapted one, see `esd.matching.judge.cost`;
        each the mean over the embeddings of both models, so that neither is judged by its own.
    is_kept
        Whether the map is by the adapted model: its cost is less.
    """

    seconds: float
    cost_before: float
    cost_after: float
    is_kept: bool

    def in_a_line(self) -> str:
        """What it cost and gave, in words."""
        costs = f"from {self.cost_before:.2f} to {self.cost_after:.2f}"
        if self.is_kept:
            return f"Adapting the model took {self.seconds:.0f} s; the cost fell {costs}."
        return (
            f"Adapting the model took {self.seconds:.0f} s and gave nothing: the cost rose "
            f"{costs}, so the map is by the model as it was."
        )


@dataclass(frozen=True, slots=True)
class Overlap:
    """How far two shapes are parts of one whole.

    Parameters
    ----------
    source
        Share of the source's area that has a counterpart.
    scale
        Length in the source that is 1 in the target, as it was taken to be.
    consistent
        Share of the smaller shape's area that the map takes there and back, see
        `esd.matching.partial.consistent_share`.
    """

    source: float
    scale: float
    consistent: float

    def in_a_line(self) -> str:
        """What it means, in words."""
        unit = "of one unit of length"
        if abs(np.log(self.scale)) > _SAME_UNIT:
            unit = f"of different units, a length of 1 in the target {self.scale:.3g} in the source"
        return (
            f"Partial: about {self.source:.0%} of the source has a counterpart; the shapes were "
            f"taken to be {unit}."
        )


@dataclass(frozen=True, slots=True)
class Judgement:
    """What is to be thought of a map as a whole.

    Parameters
    ----------
    verdict
        `good`, `doubtful`, `failed`, or `mirrored`.
    expected_accuracy
        Mean confidence of all source vertices that have a face: the share that should have a
        counterpart and lie within 5 % of the geodesic diameter of it.
    orientation
        Between −1 and 1: the share of the source's surface, by area, that keeps its side under
        the map less the share that is reversed, as the faces of both files are oriented.
    costs
        Of the candidates that the map was chosen from, by name, see `esd.matching.judge`; the
        least is best. Empty where there was no choice.
    is_mirrored
        Whether the source was mirrored before it was matched.
    contradicted
        Indices of the landmarks that the others contradict, and that were left out.
    unmatched
        Share of the source's vertices with a face that lie on loose pieces too far from the one
        that was matched. They count as wrong.
    not_repaired
        What does harm in either shape and was not repaired, in words.
    adaptation
        What adapting the model to the two shapes cost and gave; None where it was not adapted.
    overlap
        Where the map is one between parts; None for maps between whole shapes. Vertices without a
        counterpart do not count in the expected accuracy.
    """

    verdict: Verdict
    expected_accuracy: float
    orientation: float
    costs: Mapping[str, float] = field(default_factory=dict)
    is_mirrored: bool = False
    contradicted: tuple[int, ...] = ()
    unmatched: float = 0.0
    not_repaired: str = ""
    adaptation: Adaptation | None = None
    overlap: Overlap | None = None

    @property
    def candidate(self) -> str | None:
        """Name of the candidate that was chosen; None where there was no choice."""
        if self.overlap is not None:
            return "part"
        return min(self.costs, key=lambda name: self.costs[name]) if self.costs else None

    @property
    def advice(self) -> str:
        """What to do; empty if the map is good."""
        parts = [ADVICE[self.verdict]]
        if self.overlap is not None:
            parts.append(self.overlap.in_a_line())
        if self.unmatched >= _WORTH_SAYING:
            parts.append(
                f"{self.unmatched:.0%} of the source lies on loose pieces too far off to match."
            )
        if self.not_repaired and self.verdict != "good":
            parts.append(f"Not repaired: {self.not_repaired}.")
        return " ".join(filter(None, parts))


def evidence(
    source: Mesh, target: Mesh, target_index: IntArray, source_index: IntArray
) -> FloatArray:
    """What speaks against each match, (n, 2), in shares of the square root of the area.

    The distance by which going to the target and back misses a source vertex, and the longest way
    between the images of the ends of one of its edges, both as means over the vertices two edges
    around. NaN where there is no match.

    Parameters
    ----------
    target_index : (n,)
        The map to judge.
    source_index : (m,)
        A map back, found independently.
    """
    matched = target_index >= 0
    here = source.vertices / np.sqrt(surface_area(source))
    there = target.vertices / np.sqrt(surface_area(target))
    again = np.where(matched, source_index[target_index], -1)
    astray = np.where(again >= 0, np.linalg.norm(here - here[again], axis=1), np.nan)
    pairs = edges(source)
    i, j = pairs.T
    jump = np.linalg.norm(there[target_index[i]] - there[target_index[j]], axis=1)
    jump[~(matched[i] & matched[j])] = 0.0
    longest = np.zeros(len(here))
    for end in (i, j):
        np.maximum.at(longest, end, jump)
    values = np.stack([astray, longest], axis=1)
    values[~np.isfinite(astray)] = np.nan
    return _around(adjacency(pairs, len(here)), values)


def confidence(
    source: Mesh,
    target: Mesh,
    target_index: IntArray,
    source_index: IntArray,
    *,
    accuracy: float | None = None,
) -> FloatArray:
    """Probability, (n,), that each match is within 5 % of the target's diameter of the truth.

    A logistic function of the logarithms of the `evidence`, fitted to refined maps between people
    and between animals, and with an expected accuracy to those of heads, skulls and shapes of
    different classes too (`benchmarks/judge.py`). Zero where there is no match.

    Parameters
    ----------
    accuracy
        Of the map as a whole, as the judge of candidates expects it, see `esd.matching.judge`:
        smooth maps that return there and back may be wrong all the same.
    """
    constant, *factors = _LOGISTIC if accuracy is None else _JUDGED[:3]
    logit = constant + np.log(
        evidence(source, target, target_index, source_index) + _OFFSET
    ) @ np.array(factors)
    if accuracy is not None:
        bounded = min(max(accuracy, 0.02), 0.995)
        logit = logit + _JUDGED[3] * np.log(bounded / (1 - bounded))
    return np.where(target_index >= 0, np.nan_to_num(1 / (1 + np.exp(-logit))), 0.0)


def orientation(source: Mesh, target: Mesh, target_index: IntArray) -> float:
    """Share of the source's area that keeps its orientation, less the share reversed.

    Faces whose corners do not go to three vertices have no part.
    """
    image = target_index[source.faces]
    a, b, c = (target.vertices[image[:, corner]] for corner in range(3))
    turn = np.einsum("ij,ij->i", np.cross(b - a, c - a), vertex_normals(target)[image].sum(axis=1))
    area = face_areas(source)
    mapped = (image >= 0).all(axis=1) & (turn != 0)
    return float(
        area[mapped] @ np.sign(turn[mapped]) / max(area[mapped].sum(), np.finfo(float).tiny)
    )


def judgement(
    source: Mesh,
    target: Mesh,
    target_index: IntArray,
    values: FloatArray,
    *,
    counted: BoolArray | None = None,
    turned_over: bool = False,
    unmatched: float = 0.0,
) -> Judgement:
    """The verdict on a map, from its `confidence` and its `orientation`.

    Parameters
    ----------
    values : (n,)
        The confidence.
    counted : (n,)
        Vertices whose confidence counts, by default all that have a face.
    turned_over
        Whether the faces of just one of the meshes were turned before it was matched.
    unmatched
        Share of the source that was not matched, beside what `values` are of.
    """
    counted = is_referenced(source) if counted is None else counted
    accuracy = float(values[counted].mean()) * (1 - unmatched) if counted.any() else 0.0
    side = orientation(source, target, target_index) * (-1 if turned_over else 1)
    if side < -_ORIENTED and accuracy >= _FAILED:
        return Judgement("mirrored", accuracy, side, unmatched=unmatched)
    verdict: Verdict = "failed"
    if accuracy >= _FAILED:
        verdict = "good" if accuracy >= _GOOD and side > _ORIENTED else "doubtful"
    return Judgement(verdict, accuracy, side, unmatched=unmatched)


def _around(neighbours: sparse.csr_array, values: FloatArray) -> FloatArray:
    """Means of values (n, c) over the vertices up to two edges around, NaN left out."""
    near = neighbours + sparse.eye_array(len(values), format="csr")
    known = np.isfinite(values)
    total = near @ (near @ np.where(known, values, 0.0))
    weight = near @ (near @ known.astype(float))
    return np.where(known, total / np.maximum(weight, 1.0), np.nan)
