"""The best of several candidates, computed no further than needed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from esd.common import InputError
from esd.matching.candidates import (
    CANDIDATES,
    FROM_POSE,
    Candidate,
    Rows,
    Sampled,
    extrinsic_candidate,
    pair_descriptors,
    sampled,
    spectral_candidate,
)
from esd.matching.extrinsic import Alignment, aligned, deformed
from esd.matching.features import Features
from esd.matching.judge import Evidence, accuracy, cost, evidence
from esd.nearest import nearest
from esd.parallel import side_by_side

_SURE = 0.97  # expected accuracy of a candidate beyond which shapes of other poses get no more
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
    """

    candidate: Candidate
    evidence: Evidence
    costs: dict[str, float]


def check_candidates(names: Sequence[str]) -> tuple[str, ...]:
    """The names, if all are of `CANDIDATES`; raises an `InputError` otherwise."""
    unknown = [name for name in names if name not in CANDIDATES]
    if unknown or not names:
        raise InputError(
            f"Candidates are {', '.join(CANDIDATES)}; got {', '.join(unknown) or 'none'}."
        )
    return tuple(dict.fromkeys(names))


def chosen(
    source: Features, target: Features, *, names: Sequence[str] = tuple(CANDIDATES)
) -> Choice:
    """The candidate of least cost, see `esd.matching.judge`.

    First come maps by embeddings and by the descriptors of the pair; the similarities that fit
    them are starts of the alignment as well. Where one of them is sure and the alignment shows
    that the shapes are of different poses, that is all.

    Raises
    ------
    InputError
        If a name is unknown.
    """
    names = check_candidates(names)
    shapes = side_by_side(sampled, (source, target))
    descriptors = pair_descriptors(shapes[0], shapes[1])
    rows = {"embedding": (source.embedded, target.embedded), "descriptors": descriptors}
    found = _judged(
        [
            spectral_candidate(name, shapes[0], shapes[1], rows[name])
            for name in names
            if name in rows
        ],
        shapes,
        descriptors,
    )
    if any(name.startswith("extrinsic") for name in names):
        alignment = _aligned(shapes, [candidate for candidate, _ in found])
        sure = any(accuracy(each) >= _SURE for _, each in found)
        if not sure or alignment.residual < _OTHER_POSE:
            found += _judged(_extrinsic(shapes, alignment, rows, names), shapes, descriptors)
    costs = {candidate.name: cost(each) for candidate, each in found}
    best = min(found, key=lambda each: costs[each[0].name])
    return Choice(*best, costs)


def _aligned(shapes: Sequence[Sampled], candidates: Sequence[Candidate]) -> Alignment:
    """The source on the target, from the candidates' maps among other starts."""
    source, target = shapes
    maps = [
        nearest(each.forward[0][source.posed.sample], each.forward[1])[0] for each in candidates
    ]
    return aligned(source.posed, target.posed, maps=maps)


def _extrinsic(
    shapes: Sequence[Sampled],
    alignment: Alignment,
    rows: dict[str, Rows],
    names: Sequence[str],
) -> list[Candidate]:
    source, target = shapes
    extrinsic = extrinsic_candidate(deformed(alignment.source, target.posed), target.posed)
    here, there = source.posed.sample, target.posed.sample
    at_samples = extrinsic.forward[0][here], extrinsic.forward[1][there]
    start = nearest(*at_samples)[0], nearest(*at_samples[::-1])[0]
    refined = [
        spectral_candidate(f"extrinsic+{name}", source, target, each, start=start, sizes=FROM_POSE)
        for name, each in rows.items()
        if f"extrinsic+{name}" in names
    ]
    return [extrinsic, *refined] if "extrinsic" in names else refined


def _judged(
    candidates: Sequence[Candidate], shapes: Sequence[Sampled], descriptors: Rows
) -> list[tuple[Candidate, Evidence]]:
    source, target = shapes

    def judged(candidate: Candidate) -> Evidence:
        return evidence(source, target, candidate, descriptors)

    return list(zip(candidates, side_by_side(judged, candidates), strict=True))
