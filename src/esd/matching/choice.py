"""The best of several candidates, computed no further than needed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import KDTree

from esd.common import InputError, IntArray
from esd.matching.candidates import (
    CANDIDATES,
    FROM_POSE,
    LANDMARK_CANDIDATES,
    Candidate,
    PairDescriptors,
    Rows,
    Sampled,
    extrinsic_candidate,
    pair_descriptors,
    sample_maps,
    sampled,
    spectral_candidate,
)
from esd.matching.extrinsic import Alignment, aligned, deformed
from esd.matching.features import Features
from esd.matching.judge import Evidence, accuracy, cost, evidence
from esd.matching.landmarks import FEWEST, contradicted, landmark_candidates
from esd.matching.registered import (
    REGISTERED,
    Coarse,
    coarse,
    registered,
    smoothed,
    with_embeddings,
)
from esd.nearest import nearest
from esd.parallel import side_by_side

CHAIN = "chain"
"""Name of the candidate that refines a map by way of other shapes."""

_SURE = 0.97  # expected accuracy of a candidate beyond which shapes of other poses get no more
_OF_A_LANDMARK = 1.0  # cost of leaving out one of four
_ONE_POSE = 0.02  # in √area: residual of the map below which only details differ: skulls 0.01
_NOT_AFFINE = 0.05  # in √area: residual of a sure map beyond which shapes are not of one pose
_OTHER_POSE = 0.07  # residual of the alignment beyond which shapes are not of one pose


@dataclass(frozen=True, slots=True, eq=False)
class Choice:
    """The candidate that was chosen, and what speaks for it.

    Parameters
    ----------
    candidate
        The best.
    evidence
        Of it.
    costs
        Of all that were computed, by name; the least is best.
    contradicted
        Indices of the landmarks that the others contradict.
    computed
        All candidates that were computed, with their evidence.
    shapes
        The source and the target with their samples.
    descriptors
        The `pair_descriptors` of these.
    copies
        Of the shapes, on which candidates were registered; None if none was.
    """

    candidate: Candidate
    evidence: Evidence
    costs: dict[str, float]
    contradicted: IntArray
    computed: tuple[tuple[Candidate, Evidence], ...]
    shapes: tuple[Sampled, Sampled]
    descriptors: PairDescriptors
    copies: tuple[Coarse, Coarse] | None = None

    def judged(self, candidate: Candidate) -> Evidence:
        """The evidence for a further candidate for the same shapes."""
        return evidence(*self.shapes, candidate, self.descriptors)


def check_candidates(names: Sequence[str], *, landmarks: bool = False) -> tuple[str, ...]:
    """The names, if all are of `CANDIDATES`, or, with landmarks, of `LANDMARK_CANDIDATES` too.

    Raises
    ------
    InputError
        If a name is unknown, or there is none.
    """
    known = CANDIDATES | LANDMARK_CANDIDATES if landmarks else CANDIDATES
    unknown = [name for name in names if name not in known]
    if unknown or not names:
        raise InputError(f"Candidates are {', '.join(known)}; got {', '.join(unknown) or 'none'}.")
    if set(names) == {REGISTERED}:
        raise InputError(f"The candidate '{REGISTERED}' starts from others; add some beside it.")
    return tuple(dict.fromkeys(names))


def chosen(
    source: Features,
    target: Features,
    *,
    names: Sequence[str] | None = None,
    landmarks: IntArray | None = None,
) -> Choice:
    """The candidate of least cost, see `esd.matching.judge`.

    First come maps by embeddings and, unless these are sure, by the descriptors of the pair; the
    similarities that fit them are starts of the alignment as well. Where one of them is sure, it is
    the only start; it is all, if it or the alignment then shows shapes of different poses.

    Parameters
    ----------
    names
        Of the candidates; by default those of `LANDMARK_CANDIDATES` if there are landmarks, else
        all of `CANDIDATES`.
    landmarks : (l, 2)
        Vertices of both shapes that correspond. Those that the others contradict are left out.

    Raises
    ------
    InputError
        If a name is unknown.
    """
    if names is None:
        names = tuple(CANDIDATES if landmarks is None else LANDMARK_CANDIDATES)
    names = check_candidates(names, landmarks=landmarks is not None)
    shapes = _both_sampled(source, target)
    descriptors = pair_descriptors(*shapes)
    rows = {"embedding": (source.embedded, target.embedded)}
    found: list[tuple[Candidate, Evidence]] = []

    def add(name: str) -> None:
        if name in names:
            candidate = spectral_candidate(name, shapes[0], shapes[1], rows[name])
            found.extend(_judged([candidate], shapes, descriptors))

    add("embedding")
    # descriptors find nothing better than a model that is sure
    if not _is_sure(found) or landmarks is not None:
        rows["descriptors"] = descriptors.rows()
        if not _is_sure(found):
            add("descriptors")
    doubtful: IntArray = np.zeros(0, dtype=np.int64)
    if landmarks is not None:
        by_landmarks, doubtful = _by_landmarks(shapes, landmarks, rows, names, descriptors)
        found += by_landmarks
    if any(name.startswith("extrinsic") for name in names) and not _is_of_another_pose(found):
        sure = _is_sure(found)
        alignment = _aligned(shapes, [candidate for candidate, _ in found], search=not sure)
        if not sure or alignment.residual < _OTHER_POSE:
            if "descriptors" not in rows:
                rows["descriptors"] = descriptors.rows()
            found += _judged(_extrinsic(shapes, alignment, rows, names), shapes, descriptors)
    costs = {candidate.name: cost(each) for candidate, each in found}
    best = min(found, key=lambda each: costs[each[0].name])
    return Choice(*best, costs, doubtful, tuple(found), shapes, descriptors)


def is_sure(choice: Choice) -> bool:
    """Whether what was chosen is expected to be right nearly everywhere."""
    return accuracy(choice.evidence) >= _SURE


def elastic(choice: Choice) -> Choice:
    """The choice, or a registered candidate in its place where none is sure.

    Each candidate is registered, see `esd.matching.registered`; the best of the results is refined
    coarsely and registered once more. Shapes that are no oriented manifolds cannot be, and those
    of one pose need not: smooth deformation is better there.
    """
    if is_sure(choice) or choice.evidence.residual < _ONE_POSE:
        return choice
    source, target = side_by_side(coarse, choice.shapes)
    if source is None or target is None:
        return choice
    embeddings = choice.shapes[0].features.embedded, choice.shapes[1].features.embedded

    def judged(starts: Sequence[Candidate]) -> list[tuple[Candidate, Evidence]]:
        made = side_by_side(lambda start: registered(source, target, start), starts)
        found = [each for each in made if each is not None]
        return _judged(found, choice.shapes, choice.descriptors)

    found = judged([each for each, _ in choice.computed])
    if not found:
        return choice
    best = min(found, key=lambda each: cost(each[1]))[0]
    found += judged([smoothed(*choice.shapes, with_embeddings(best, embeddings))])
    best, its_evidence = min(found, key=lambda each: cost(each[1]))
    costs = choice.costs | {REGISTERED: cost(its_evidence)}
    choice = replace(
        choice, costs=costs, computed=(*choice.computed, *found), copies=(source, target)
    )
    if costs[REGISTERED] > min(costs.values()):
        return choice
    return replace(choice, candidate=with_embeddings(best, embeddings), evidence=its_evidence)


def _both_sampled(source: Features, target: Features) -> tuple[Sampled, Sampled]:
    here, there = side_by_side(sampled, (source, target))
    return here, there


def chained(source: Features, target: Features, by_way: IntArray) -> Choice:
    """The candidate that refines a known map, such as one by way of other shapes.

    Parameters
    ----------
    by_way : (n,)
        The target vertex of each source vertex, of the shapes as they are matched; -1 for none.

    Raises
    ------
    InputError
        If no vertex has a match.
    """
    known = np.flatnonzero(by_way >= 0)
    if len(known) == 0:
        raise InputError("A map to be refined has no match.")
    shapes = _both_sampled(source, target)
    descriptors = pair_descriptors(*shapes)
    here, there = (shape.posed.sample for shape in shapes)
    # the image of each sample of the source, by the nearest vertex that has one
    points = shapes[0].points
    image = by_way[known[KDTree(points[known]).query(points[here])[1]]]
    keys = shapes[1].posed.keys()
    start = (
        np.asarray(KDTree(keys[there]).query(keys[image])[1]),
        np.asarray(KDTree(keys[image]).query(keys[there])[1]),
    )
    embeddings = source.embedded, target.embedded
    candidate = spectral_candidate(
        CHAIN, shapes[0], shapes[1], embeddings, start=start, sizes=FROM_POSE
    )
    judged = _judged([candidate], shapes, descriptors)
    found = judged[0][1]
    nothing: IntArray = np.zeros(0, dtype=np.int64)
    costs = {CHAIN: cost(found)}
    return Choice(candidate, found, costs, nothing, tuple(judged), shapes, descriptors)


def _by_landmarks(
    shapes: Sequence[Sampled],
    landmarks: IntArray,
    rows: dict[str, Rows],
    names: Sequence[str],
    descriptors: PairDescriptors,
) -> tuple[list[tuple[Candidate, Evidence]], IntArray]:
    """Candidates by the landmarks, and the indices of those left out, in ascending order.

    Of few landmarks, a right one may seem contradicted: what is left out is what makes the map
    clearly better, and the more clearly, the fewer there are.
    """
    order = contradicted(shapes[0], shapes[1], landmarks, rows["descriptors"])
    ways = []
    for count in range(len(order), -1, -1):
        sound = np.delete(landmarks, order[:count], axis=0)
        made = landmark_candidates(shapes[0], shapes[1], sound, rows, names)
        found = _judged(made, shapes, descriptors)
        price = count * _OF_A_LANDMARK / max(len(landmarks) - FEWEST, 1)
        least = min((cost(each) for _, each in found), default=0.0)
        ways.append((least + price, found, np.sort(order[:count])))
    return min(ways, key=lambda way: way[0])[1:]


def _is_sure(found: Sequence[tuple[Candidate, Evidence]]) -> bool:
    return any(accuracy(each) >= _SURE for _, each in found)


def _is_of_another_pose(found: Sequence[tuple[Candidate, Evidence]]) -> bool:
    """Whether a candidate that is sure is so far from affine that no alignment is a good start."""
    residuals = [each.residual for _, each in found if accuracy(each) >= _SURE]
    return bool(residuals) and max(residuals) > _NOT_AFFINE


def _aligned(
    shapes: Sequence[Sampled], candidates: Sequence[Candidate], *, search: bool
) -> Alignment:
    """The source on the target, from the candidates' maps, and other starts if these are sought."""
    source, target = shapes
    sample = source.posed.sample
    matches = [
        (sample, nearest(each.forward[0][sample], each.forward[1])[0]) for each in candidates
    ]
    return aligned(source.posed, target.posed, matches=matches, search=search)


def _extrinsic(
    shapes: Sequence[Sampled],
    alignment: Alignment,
    rows: dict[str, Rows],
    names: Sequence[str],
) -> list[Candidate]:
    source, target = shapes
    extrinsic = extrinsic_candidate(deformed(alignment.source, target.posed), target.posed)
    start = sample_maps(source, target, extrinsic)
    refined = [
        spectral_candidate(f"extrinsic+{name}", source, target, each, start=start, sizes=FROM_POSE)
        for name, each in rows.items()
        if f"extrinsic+{name}" in names
    ]
    return [extrinsic, *refined] if "extrinsic" in names else refined


def _judged(
    candidates: Sequence[Candidate], shapes: Sequence[Sampled], descriptors: PairDescriptors
) -> list[tuple[Candidate, Evidence]]:
    source, target = shapes

    def judged(candidate: Candidate) -> Evidence:
        return evidence(source, target, candidate, descriptors)

    return list(zip(candidates, side_by_side(judged, candidates), strict=True))
