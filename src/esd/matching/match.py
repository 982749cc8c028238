"""From two shapes to a correspondence."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal, TypeAlias, get_args

import numpy as np

from esd.common import BoolArray, FloatArray, InputError, IntArray
from esd.learning.model import Model, load_model
from esd.matching.assignment import one_to_one as assignment
from esd.matching.candidates import CANDIDATES, Candidate, Rows, candidate_of
from esd.matching.choice import Choice, chained, check_candidates, chosen, elastic, is_sure
from esd.matching.confidence import Adaptation, Overlap, confidence, judgement
from esd.matching.correspondence import Correspondence
from esd.matching.features import Features, reflected, shape_features
from esd.matching.judge import accuracy, cost
from esd.matching.landmarks import check_landmarks
from esd.matching.local_refine import Level, levels, local_zoomout
from esd.matching.partial import PartMap, consistent_share
from esd.matching.parts import MISFITS, Scale, best_part_map, is_calibrated
from esd.matching.points import accuracy_of_points, evidence_of_points, with_surface
from esd.matching.refine import SIZES, joint_rows, mean_squared_distance
from esd.matching.registered import REGISTERED, registered
from esd.mesh.convert import MeshLike
from esd.mesh.geometry import is_referenced
from esd.mesh.mesh import Mesh
from esd.mesh.repair.repair import Repaired, repair
from esd.nearest import nearest
from esd.parallel import side_by_side
from esd.spectral.cache import Cache, default_cache
from esd.spectral.coarse import coarse_copy

_log = logging.getLogger(__name__)

DEFAULT_MODEL = "default"
"""Name of the model that is used where none is given."""

DENSE = 20_000
"""Number of vertices beyond which a map goes by way of coarse copies."""

COARSE = 10_000
"""Number of vertices of these copies."""

Mirror: TypeAlias = Literal["auto", "yes", "no"]

_PART = "part"  # of `CANDIDATES`
_COUNTERPART = 0.5  # probability of a counterpart beyond which a vertex is matched
_NOT_CALIBRATED = 0.89  # factor of the confidence by another model of parts: at best doubtful
_AS_CONSISTENT = 0.02  # share by which maps between parts may be less consistent than others
_LEFT = 0.02  # sum of the shares that are lost there and back, and uncovered, below which nothing
# seems to be missing; teeth, open as they are, have 0.007 at most, people cut by a tenth 0.045
_LIKELY = 0.5  # and expected accuracy below which it may all the same
_SURE = 0.9  # expected accuracy beyond which a mirror image is not tried
_CLEARLY = 6.3  # least difference of costs by which a mirror image is taken; hands have 8 or more
_SYMMETRIC = 0.85  # expected accuracy of the map from the mirror image of a shape to itself, beyond
# which it has two like sides; people, skulls and most animals have 0.9 or more, hands 0.7
_BACK_SIZES = (60, 160)  # of the map back, which only serves to judge the map


def match(
    source: MeshLike | Repaired,
    target: MeshLike | Repaired,
    *,
    model: Model | str | os.PathLike[str] = DEFAULT_MODEL,
    refine: bool | None = None,
    one_to_one: bool = False,
    candidates: Sequence[str] | None = None,
    landmarks: IntArray | None = None,
    mirror: Mirror = "auto",
    scale: Scale = "auto",
    adapt: bool = False,
    coarse: int | None = None,
    full: bool = False,
    cache: Cache | None = None,
) -> Correspondence:
    """The target vertex that corresponds to each source vertex, how surely, and a judgement.

    Parameters
    ----------
    source, target
        Meshes, or whatever `as_mesh` takes, or points without faces. What is wrong with them is
        logged in one line, and what can be repaired without harm is, including small holes and
        noise, see `esd.mesh.repair.repair`. The map is that of the original vertices; those left
        out have no match.
    model
        A `Model`, or what `load_model` takes.
    refine
        Whether the map is refined, see `local_zoomout`; by default if the model tells left from
        right.
    one_to_one
        Whether no target vertex may be matched twice; source vertices are then left out.
    candidates
        Names of the maps to choose from, see `esd.matching.candidates.CANDIDATES`; by default all
        if the map is refined, else nearest embeddings alone.
    landmarks : (l, 2) int
        Source vertices and target vertices that correspond, three or more; they may be some edges
        off. Those that the others contradict are logged and left out.
    mirror
        Whether the source is mirrored before it is matched: left hands to right ones. With `auto`,
        it is where the mirror image fits clearly better and the source has no two like sides, as
        people and animals have, see `Judgement.is_mirrored`.
    scale
        Whether both shapes have one unit of length, where parts of them are missing: `same`, or
        `free` if that is not known; `auto` takes it to be so unless the map fits badly.
    adapt
        Whether the model first learns on the two shapes, without correspondences, for some
        seconds; what it learned is used if the judge finds the map better, see
        `Judgement.adaptation`. Needs torch.
    coarse
        For dense meshes: number of vertices of the copies, remeshed, that are matched in their
        place; the map is upsampled to all vertices, see `esd.matching.dense`. By default ten
        thousand if a mesh has more than twenty thousand.
    full
        Whether meshes are matched as they are, dense or coarse: no copies are made.
    cache
        Where spectra and coarse copies are looked up and kept; the user's cache by default.

    Raises
    ------
    InputError
        If a mesh, the model or an option cannot be used.
    """
    check_copies(one_to_one=one_to_one, coarse=coarse, full=full)
    for name, given, known in (("mirror", mirror, Mirror), ("scale", scale, Scale)):
        if given not in get_args(known):
            raise InputError(f"`{name}` must be one of {', '.join(get_args(known))}; got {given}.")
    if candidates is not None:
        check_candidates(candidates, landmarks=landmarks is not None)
    model = model if isinstance(model, Model) else load_model(model)
    if adapt:
        from esd.matching.adapt import check_adaptation  # with much that is slow to import

        check_adaptation(model)
    cache = default_cache() if cache is None else cache
    full = full or one_to_one
    shapes = [prepared(each, coarse=coarse, full=full) for each in (source, target)]
    work = partial(
        working_features, model=model, refine=refine, coarse=coarse, full=full, cache=cache
    )
    # spectra of dense meshes not both at a time: memory is scarce
    one_by_one = full and any(map(_is_dense, shapes))
    described = [work(each) for each in shapes] if one_by_one else side_by_side(work, shapes)
    found = match_features(
        described[0],
        described[1],
        model=model,
        refine=refine,
        one_to_one=one_to_one,
        candidates=candidates,
        landmarks=landmarks,
        mirror=mirror,
        scale=scale,
        adapt=adapt,
        cache=cache,
    )
    left = []
    for name, each in zip(("source", "target"), shapes, strict=True):
        if each.in_a_line():
            _log.warning("The %s has %s.", name, each.in_a_line())
        if each.not_repaired():
            left.append(f"{each.not_repaired()} in the {name}")
    if found.judgement is None or not left or found.judgement.overlap is not None:
        return found  # maps between parts take holes as they are
    return replace(found, judgement=replace(found.judgement, not_repaired="; ".join(left)))


def check_copies(*, one_to_one: bool, coarse: int | None, full: bool = False) -> None:
    """Raise an `InputError` if a map by way of coarse copies is to be one-to-one, or full."""
    if one_to_one and coarse is not None:
        raise InputError("Maps by way of coarse copies are not one-to-one; leave out one of both.")
    if full and coarse is not None:
        raise InputError("Maps by way of coarse copies are not full; leave out one of both.")


def prepared(
    source: MeshLike | Repaired,
    *,
    everything: bool = False,
    coarse: int | None = None,
    full: bool = False,
) -> Repaired:
    """A shape repaired for `match`; a dense one so that it can be remeshed.

    Parameters
    ----------
    everything
        See `esd.mesh.repair.repair`.
    coarse, full
        See `match`.
    """
    dense = None if full else 0 if coarse is not None else DENSE
    return repair(source, everything=everything, restore=True, together=not full, dense=dense)


def working_features(
    repaired: Repaired,
    *,
    model: Model,
    refine: bool | None = None,
    coarse: int | None = None,
    full: bool = False,
    cache: Cache | None = None,
) -> Features:
    """The features that `match` computes of a shape: of a copy where it is too dense or coarse.

    See `match` for the parameters.
    """
    if coarse is None and not full and _is_dense(repaired):
        coarse = COARSE
        _log.info("Matching a copy of %d vertices; --full matches all.", coarse)
    resample = not full and (model.is_oriented if refine is None else refine)
    return shape_features(repaired, model=model, coarse=coarse, resample=resample, cache=cache)


def _is_dense(repaired: Repaired) -> bool:
    return isinstance(repaired.shape, Mesh) and len(repaired.shape.vertices) > DENSE


def match_features(
    source: Features,
    target: Features,
    *,
    model: Model,
    refine: bool | None = None,
    one_to_one: bool = False,
    candidates: Sequence[str] | None = None,
    landmarks: IntArray | None = None,
    mirror: Mirror = "auto",
    scale: Scale = "auto",
    adapt: bool = False,
    by_way: IntArray | None = None,
    cache: Cache | None = None,
) -> Correspondence:
    """As `match`, of the features of a source and a target by the model.

    Parameters
    ----------
    by_way : (n,)
        A map between the original vertices, -1 for none, such as one by way of other shapes. It is
        refined, and no candidates are computed.
    cache
        Where spectra of the copies that a model is adapted on are looked up and kept.
    """
    refine = model.is_oriented if refine is None else refine
    # a map between parts is found beside the others
    others = None if candidates is None else tuple(c for c in candidates if c != _PART)
    is_mesh = isinstance(source.shape, Mesh) and isinstance(target.shape, Mesh)
    costs: dict[str, float] = {}
    expected: float | None = None
    contradicted: tuple[int, ...] = ()
    is_mirrored = False
    adaptation: Adaptation | None = None
    used = np.zeros(0, dtype=np.int64)
    if landmarks is not None and is_mesh:
        landmarks, used = _located(landmarks, source, target)
    if adapt:
        from esd.matching.adapt import adapted_model

        model, adaptation = adapted_model(
            reflected(source, model=model) if mirror == "yes" else source,
            target,
            model=model,
            names=others or None,
            landmarks=landmarks,
            cache=cache,
        )
        source, target = source.embedded_by(model), target.embedded_by(model)
    choice: Choice | None = None
    parts: PartMap | None = None
    if by_way is not None and is_mesh:
        choice = chained(source, target, _on_shapes(by_way, source, target))
    elif is_mesh and (refine or candidates or landmarks is not None or mirror == "yes"):
        names = others or None
        plain = None
        if mirror != "yes":
            plain = chosen(source, target, names=names, landmarks=landmarks)
            is_asked = others == () or (_PART in (candidates or CANDIDATES) and not _fits(plain))
            if is_asked:
                parts = best_part_map(
                    source, target, model=model, scale=scale, landmarks=landmarks, cache=cache
                )
        if parts is None and others == ():
            raise InputError(
                "The candidate 'part' needs a mesh with a cut or large holes, and an orientation "
                "that is not mirrored; add others beside it."
            )
        # what is missing makes mirror images look as good
        are_parts = parts is not None and parts.consistent > MISFITS
        choice, mirrored = _mirror_chosen(
            source,
            target,
            plain,
            model=model,
            names=names,
            landmarks=landmarks,
            mirror="no" if are_parts else mirror,
        )
        if mirrored is not None:
            source, is_mirrored, parts = mirrored, True, None
        if not are_parts and REGISTERED in (names or CANDIDATES):
            choice = elastic(choice)
    elif landmarks is not None or mirror == "yes":
        raise InputError("Landmarks and mirror images need meshes; these are points.")
    if choice is not None:
        expected = accuracy(choice.evidence)
        costs, contradicted = choice.costs, tuple(used[choice.contradicted].tolist())
        candidate = choice.candidate
        if candidate.name == "embedding" and is_sure(choice):
            # exact embeddings, which the candidate's coarse refinement makes less so
            embeddings = source.embedded, target.embedded
            candidate = replace(candidate, forward=embeddings, backward=embeddings)
        maps = _full_maps(source, target, candidate, refine=refine, device=model.device)
        if refine and (choice.copies is not None or choice.candidate.is_extrinsic):
            maps = _tightened(source, target, choice, maps, device=model.device)
    else:
        maps = _nearest_maps(source, target, refine=refine, device=model.device)
    if parts is not None and others != () and not _fits_better(parts, maps, expected or 0.0):
        parts = None
    is_copy = source.copy is not None or target.copy is not None
    kept: BoolArray | None = None
    rows = source.embedded, target.embedded
    if parts is not None:
        rows = parts.rows
    elif one_to_one or is_copy:
        rows = maps.rows()
    index = assignment(*rows) if one_to_one else (maps.index if parts is None else parts.forward)
    if parts is None:
        found = with_similarity(source.embedded, target.embedded, index, margin=model.margin)
        if not is_mesh:
            surfaces = with_surface(source), with_surface(target)
            expected = accuracy_of_points(evidence_of_points(*surfaces, index, maps.back))
            found = _judged(found, maps.back, *surfaces, expected)
        else:
            found = _judged(found, maps.back, source, target, expected)
    else:
        embeddings = parts.source.embedded, parts.target.embedded
        found = with_similarity(*embeddings, index, margin=None)
        has_counterpart, right = parts.probabilities()
        if not is_calibrated(model):
            right = _NOT_CALIBRATED * right
        kept = has_counterpart > _COUNTERPART
        found = _judged_parts(found, parts, has_counterpart, right, source, target)
    if found.judgement is not None:
        found = replace(
            found,
            judgement=replace(
                found.judgement,
                costs=costs,
                is_mirrored=is_mirrored,
                contradicted=contradicted,
                adaptation=adaptation,
            ),
        )
    if is_copy:
        from esd.matching.dense import carried_to_dense  # with trimesh, which is slow to import
        from esd.matching.precise import precise_map

        copies = [
            coarse_copy(features.shape, len(features.shape.vertices))
            if features.copy is None
            else features.copy
            for features in (source, target)
        ]
        image = precise_map(*rows, copies[1].mesh.faces, found.target_index)
        found = carried_to_dense(found, image, *copies)
        if kept is not None:
            kept = copies[0].carried(kept.astype(np.float64)) > _COUNTERPART
    if kept is not None:
        found = found.keeping(kept)
    found = _for_original_vertices(found, source, target)
    return _without_doubles(found, source) if one_to_one else found


def _located(landmarks: IntArray, source: Features, target: Features) -> tuple[IntArray, IntArray]:
    """Landmarks at original vertices as vertices of the shapes, and which of them these are."""
    landmarks = check_landmarks(landmarks, len(source.vertex_index), len(target.vertex_index))
    here, there = source.located(landmarks[:, 0]), target.located(landmarks[:, 1])
    found = (here >= 0) & (there >= 0)
    if not found.all():
        _log.warning("%d landmarks lie on parts that repair dropped.", np.count_nonzero(~found))
    pairs = np.stack([here, there], axis=1)[found]
    pairs = check_landmarks(pairs, len(source.shape.vertices), len(target.shape.vertices))
    return pairs, np.flatnonzero(found)


def _on_shapes(index: IntArray, source: Features, target: Features) -> IntArray:
    """A map between original vertices as one between those of the shapes, (r,); -1 for none."""
    here = np.flatnonzero(index >= 0)
    ends = source.located(here), target.located(index[here])
    found = (ends[0] >= 0) & (ends[1] >= 0)
    result = np.full(len(source.shape.vertices), -1, dtype=np.int64)
    result[ends[0][found]] = ends[1][found]
    return result


def _fits(choice: Choice) -> bool:
    """Whether a map leaves nothing of either shape without a counterpart, and may be right."""
    found = choice.evidence
    return found.lost + found.uncovered < _LEFT and accuracy(found) >= _LIKELY


def _mirror_chosen(
    source: Features,
    target: Features,
    plain: Choice | None,
    *,
    model: Model,
    names: Sequence[str] | None,
    landmarks: IntArray | None,
    mirror: Mirror,
) -> tuple[Choice, Features | None]:
    """The best candidate for the source or its mirror image, and that image where it is for it.

    Parameters
    ----------
    plain
        The best for the source itself; None if it is to be mirrored.
    """
    if plain is not None:
        sure = accuracy(plain.evidence) >= _SURE
        if mirror == "no" or sure or not model.mirrors:
            return plain, None
    image = reflected(source, model=model)
    other = chosen(image, target, names=names, landmarks=landmarks)
    if plain is None:
        return other, image
    is_better = min(other.costs.values()) <= min(plain.costs.values()) - _CLEARLY
    if not is_better or _has_like_sides(image, source):
        return plain, None
    # poses hide like sides: one of the shapes may show what the other does not
    if _has_like_sides(reflected(target, model=model), target):
        return plain, None
    return other, image


def _has_like_sides(image: Features, shape: Features) -> bool:
    """Whether the mirror image of a shape is the shape with left and right exchanged."""
    return accuracy(chosen(image, shape).evidence) >= _SYMMETRIC


@dataclass(frozen=True, slots=True, eq=False)
class _Maps:
    """A map between all vertices, one back, and the rows whose nearest the map is."""

    index: IntArray
    back: IntArray
    rows: Callable[[], Rows]


def _nearest_maps(source: Features, target: Features, *, refine: bool, device: str) -> _Maps:
    """Maps by nearest embeddings, refined or not."""
    embeddings = source.embedded, target.embedded
    if refine:
        return _refined_maps(source, target, embeddings, embeddings, embeddings)
    index, _ = nearest(*embeddings, device=device)
    return _Maps(index, nearest(*embeddings[::-1], device=device)[0], lambda: embeddings)


def _full_maps(
    source: Features, target: Features, candidate: Candidate, *, refine: bool, device: str
) -> _Maps:
    """The maps of a candidate, refined with its embeddings if it has any."""
    forward, backward = candidate.forward, candidate.backward
    if refine and candidate.embeddings is not None:
        return _refined_maps(source, target, forward, backward, candidate.embeddings)
    index, _ = nearest(*forward, device=device)
    return _Maps(index, nearest(*backward[::-1], device=device)[0], lambda: forward)


def _tightened(
    source: Features, target: Features, choice: Choice, refined: _Maps, *, device: str
) -> _Maps:
    """The best of a candidate, its refined maps, and these registered and refined by positions.

    Between shapes of different build eigenfunctions and embeddings agree only so far: the refined
    maps of a candidate can be worse than the candidate. Nothing is registered where the choice has
    no copies.
    """
    start = candidate_of(*choice.shapes, refined.index, refined.back)
    ways = [(cost(choice.judged(start)), refined)]
    again = None if choice.copies is None else registered(*choice.copies, start)
    if again is not None:
        found = _refined_maps(source, target, again.forward, again.backward, again.forward)
        start = candidate_of(*choice.shapes, found.index, found.back)
        ways.append((cost(choice.judged(start)), found))
    least, best = min(ways, key=lambda way: way[0])
    if cost(choice.evidence) < least:
        return _full_maps(source, target, choice.candidate, refine=False, device=device)
    return best


def _refined_maps(
    source: Features, target: Features, forward: Rows, backward: Rows, embeddings: Rows
) -> _Maps:
    """Maps refined from those that go to the nearest of some rows."""
    spectra = source.spectrum, target.spectrum
    count = max(len(spectrum.mass) for spectrum in spectra)

    def leveled(features: Features) -> tuple[Level, ...]:
        return levels(features.spectrum, features.shape.vertices, count=count)

    here, there = side_by_side(leveled, (source, target))
    ways = (
        partial(local_zoomout, here, there, forward, embeddings=embeddings),
        partial(
            local_zoomout,
            there,
            here,
            backward[::-1],
            embeddings=embeddings[::-1],
            sizes=_BACK_SIZES,
        ),
    )
    (index, _), (back, _) = side_by_side(lambda way: way(), ways)
    size = min(SIZES[-1], *(len(spectrum.eigenvalues) for spectrum in spectra))
    return _Maps(index, back, lambda: joint_rows(*spectra, index, size=size, embeddings=embeddings))


def _fits_better(parts: PartMap, maps: _Maps, expected: float) -> bool:
    """Whether a map between parts is better than one between the shapes as wholes.

    Parameters
    ----------
    expected
        Accuracy of the second. Deformed shapes can be consistent on wrong limbs, so that its
        consistent share alone says too much.
    """
    share = consistent_share(parts.source, parts.target, maps.index, maps.back)
    _log.info("Consistent: %.2f as parts, %.2f as wholes.", parts.consistent, share)
    return parts.consistent > min(share, expected) - _AS_CONSISTENT


def _judged_parts(
    match: Correspondence,
    parts: PartMap,
    has_counterpart: FloatArray,
    right: FloatArray,
    source: Features,
    target: Features,
) -> Correspondence:
    """A map between parts with its confidence and a judgement of the vertices that are matched.

    Those that have a counterpart, and are not matched, count as wrong.
    """
    kept = (has_counterpart > _COUNTERPART) & (match.target_index >= 0)
    values = np.where(kept, has_counterpart * right, 0.0)
    found = has_counterpart[kept].sum() / max(has_counterpart.sum(), np.finfo(float).tiny)
    verdict = judgement(
        parts.source.mesh,
        parts.target.mesh,
        np.where(kept, match.target_index, -1),
        found * np.where(kept, right, 0.0),
        counted=kept,
        turned_over=source.is_turned != target.is_turned,
        unmatched=source.lost,
    )
    mass = parts.source.spectrum.mass
    overlap = Overlap(float(mass[kept].sum() / mass.sum()), parts.scale, parts.consistent)
    return replace(match, confidence=values, judgement=replace(verdict, overlap=overlap))


def _judged(
    match: Correspondence,
    back: IntArray,
    source: Features,
    target: Features,
    expected: float | None,
) -> Correspondence:
    """The map between two meshes with its confidence and a judgement."""
    assert isinstance(source.shape, Mesh) and isinstance(target.shape, Mesh)
    values = confidence(source.shape, target.shape, match.target_index, back, accuracy=expected)
    counted = None
    if source.copy is None and target.copy is None:
        counted = is_referenced(source.shape) & ~source.is_filling()
        counted &= match.target_index >= 0  # a one-to-one map leaves some out on purpose
        values[target.is_filling()[match.target_index]] = 0.0
    verdict = judgement(
        source.shape,
        target.shape,
        match.target_index,
        values,
        counted=counted,
        turned_over=source.is_turned != target.is_turned,
        unmatched=source.lost,
    )
    return replace(match, confidence=values, judgement=verdict)


def _for_original_vertices(
    match: Correspondence, source: Features, target: Features
) -> Correspondence:
    """The map between the original vertices, of one between repaired shapes.

    What comes to lie in a hole of the target goes to its rim, without confidence: it has no
    counterpart.
    """
    index = match.target_index[source.vertex_index]
    matched = (source.vertex_index >= 0) & (index >= 0)
    sure = matched & ~target.is_filling()[index]
    return replace(
        match,
        target_index=np.where(matched, target.original_index[index], -1),
        distance=np.where(matched, match.distance[source.vertex_index], np.inf),
        confidence=np.where(sure, match.confidence[source.vertex_index], 0.0),
    )


def _without_doubles(match: Correspondence, source: Features) -> Correspondence:
    """The map without those original vertices that share a repaired one with another."""
    index = source.vertex_index
    is_first = source.original_index[index] == np.arange(len(index))
    return match.keeping(is_first)


def with_similarity(
    source: FloatArray, target: FloatArray, target_index: IntArray, *, margin: float | None
) -> Correspondence:
    """A map as a correspondence: the distances of matched rows, and their similarities.

    Parameters
    ----------
    source, target : (n, d) and (m, d)
        Embeddings.
    margin
        C of the similarity exp(−distance² / C) (section 3.4 of the paper leaves its form open).
        Where there is none, it is the mean squared distance of any two rows, so that descriptors
        no more alike than chance have similarity exp(−1).
    """
    distance = np.linalg.norm(source - target[target_index], axis=1)
    distance = np.where(target_index >= 0, distance, np.inf)
    scale = mean_squared_distance(source, target) if margin is None else margin
    return Correspondence(target_index, distance, np.exp(-(distance**2) / scale))
