"""Maps between shapes of which parts are missing."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy import sparse
from scipy.spatial import KDTree

from esd.common import FloatArray, IntArray
from esd.descriptors.recipe import recipe_spectrum, spectrum_descriptors
from esd.learning.model import Model
from esd.matching.anchors import Anchors, agreement, agreement_with_most, anchors, nearness
from esd.matching.candidates import Rows
from esd.matching.landmarks import landmark_rows
from esd.mesh.geodesics import geodesic_graph
from esd.mesh.geometry import (
    adjacency,
    edge_lengths,
    edges,
    face_areas,
    face_normals,
    is_referenced,
    surface_area,
    unit,
    vertex_normals,
)
from esd.mesh.mesh import Mesh
from esd.mesh.sampling import spread
from esd.mesh.topology import boundary_edges
from esd.nearest import nearest
from esd.spectral.cache import Cache
from esd.spectral.spectrum import Spectrum

_SAMPLES = 1500  # at which maps are refined
_WAYS = 300  # samples from which distances along the surface are known
_ANCHORS = 150  # of these, on the source
_SUPPORTED = 0.6  # support of those anchors that are used
_BEYOND = 10.0  # distance, in √area of the whole, of what is not connected
_SIZES = (6, 6, 6, 10, 10, 10, 16, 24, 36, 54, 80, 110)  # target's functions, step by step
_MORE = 2  # source's functions beyond its share of the target's area
_WEIGHT = 2.5  # of embeddings beside functions: matched rows are as far apart in both, times this
_ANCHOR_WEIGHT = 2.0  # of rows of anchors beside embeddings, which have unit length
_AWAY = 0.15  # in √area of the larger shape: how far other anchors lead away
_AWAY_WEIGHT = 6.0  # of rows of these, which embeddings contradict
_FORBIDDEN = -10.0  # product of rows of unit length where an anchor must not lead
_HALVES = 20  # of the target's samples, drawn at random, among which anchors are sought
_FEWER_HALVES = 5  # the same at each of the other sizes
_LIKE = 0.05  # in √area of the larger shape: mean distance of anchors below which they are the same
_LANDMARK_WEIGHT = 1.5  # of rows of landmarks beside embeddings, which have unit length
_RIDGE = 1e-3
_REWEIGHTINGS = 6

# weights of the cost of a map along which a shape is deformed
_ENERGY, _APART, _BARE = 8.0, 1.0, 1.0
_ENERGY_OF_PARTS = 3.0  # of two parts, of which what the other lacks is deformed as well

_REFINED = 0.2  # consistent share that a refined map may lose

_NEAR = 0.04  # in √area of the whole, within which a way there and back returns
_STRETCH = 2.5  # times their length, beyond which the image of an edge is torn

_RINGS = 8  # of edges around a vertex, over which what speaks for a counterpart is averaged
_FEWER_RINGS = 4  # the same where one shape was deformed
_LOST = 0.5  # in √area of the whole, at which ways there and back are cut off
_INSIDE = 0.3  # the same of distances to a boundary
_OFFSETS = np.array([0.01, 0.05, 0.01, 0.01])  # of the logarithms
# constant and weights of `_evidence`: for having a counterpart, and for being matched rightly
_COUNTERPART = (-2.59, -0.24, -1.35, 0.0, 0.19, -0.5, 4.07)
_RIGHT = (0.11, 0.0, -1.15, 0.0, 0.0, -0.26, 1.86)
_OF_CLOSED = 2.84  # for having a counterpart, where the target is closed
_OF_SHARE = 2.91  # weight of the logarithm of the consistent share, for being matched rightly
_GAP = 0.3  # in √area of the whole, at which heights are cut off
_LYING = 0.03  # gap below which a sample lies on the other shape
_BEYOND_RIM = 0.1  # in √area of the whole, at which distances beyond a rim are cut off
_SLACK = 2.0  # how many times as much too long distances may be on a part, beside a whole
# where one shape was deformed: constant and weights, the last where the target is closed, for lying
# on the other shape and for keeping distances; then, of other columns, for being matched rightly
_LIES = (-11.00, -2.53, -5.99, -1.77, 3.56)
_AGREES = (-13.06, 23.30, 7.62)
_RIGHT_LYING = (-3.61, -0.69, 2.32, -3.52, 3.11)
_CLEAR, _ALONE = 0.25, 0.2  # margin beyond which it says no more, and that where there is no other
_UNCLEAR = 0.1  # below which another map may as well be right, and nothing here
_DISAGREE, _AGREE, _AT_MOST = 0.6, 0.15, 0.75  # that it is right all the same: 0 for that share of
# samples that agree, rising to 1 over so much more, but no more than that
# mean logarithm of the distance of matched embeddings beyond which a map is not sure: with a whole
# shape, and between two parts
_UNLIKE, _UNLIKE_PARTS = -0.35, -0.75
_NARROW = 1.1  # diameter of a target, in √area of the whole, of which 5 % are no more than errors
_CLOSE = 0.15  # margin below which a map with a whole shape is not sure
_UNSURE = 0.89  # factor of the probability of being right there: at best doubtful


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """A shape as a part of a whole.

    Parameters
    ----------
    mesh
        Without what fills its holes; these vertices are left, without faces.
    spectrum
        Whose area is the shape's share of the whole's.
    embedded : (n, d)
        Embedding of its vertices; NaN at those without a face.
    points : (n, 3)
        Its vertices, in units of √area of the whole.
    sample : (s,)
        Vertices spread over it.
    ways : (w, n)
        Distances along the surface from the first of these, in units of √area of the whole.
    """

    mesh: Mesh
    spectrum: Spectrum
    embedded: FloatArray
    points: npt.NDArray[np.float64]
    sample: IntArray
    ways: FloatArray


def part(
    mesh: Mesh,
    whole_area: float,
    *,
    model: Model,
    known: Part | None = None,
    cache: Cache | None = None,
) -> Part:
    """A mesh as a part of a whole of some area, by a model of parts.

    Parameters
    ----------
    known
        The same mesh as a part of a whole of another area, of which is taken what does not depend
        on that.

    Raises
    ------
    InputError
        If the mesh cannot be described.
    """
    unit = 1 / np.sqrt(whole_area)
    if known is None:
        spectrum = recipe_spectrum(model.recipe, mesh, cache=cache)
        used = np.flatnonzero(is_referenced(mesh))
        sample = used[spread(mesh.vertices[used], _SAMPLES)]
        ways = unit * geodesic_graph(mesh).distances(sample[:_WAYS]).astype(np.float32)
    else:
        spectrum, sample = known.spectrum, known.sample
        ways = known.ways * np.float32(unit * np.sqrt(surface_area(mesh) / spectrum.area))
    ways = np.minimum(ways, _BEYOND)
    spectrum = spectrum.with_area(surface_area(mesh) / whole_area)
    values = spectrum_descriptors(model.recipe, mesh, spectrum, single=True, cache=cache)
    embedded = model.embed(values, model.operator(mesh, spectrum, cache=cache))
    return Part(mesh, spectrum, embedded, unit * mesh.vertices, sample, ways)


@dataclass(frozen=True, slots=True, eq=False)
class PartFit:
    """How one shape lies on another when it is deformed, see `esd.matching.part_registration`.

    Parameters
    ----------
    gap : (n,) and (m,)
        From each vertex of the source and of the target to the other shape, in √area of the whole.
    of_source
        Whether the source was deformed, not the target.
    of_parts
        Whether both shapes are parts.
    enlargement
        How much longer lengths became on what was deformed.
    energy
        Of the deformation, over the area of what is deformed.
    apart
        Mean distance of the embeddings of the smaller shape and of what it lies next to.
    covered
        Share of the smaller shape that lies on the other.
    margin
        By how much the best of the maps that lead elsewhere costs more; None where there is none.
    """

    gap: tuple[FloatArray, FloatArray]
    of_source: bool
    of_parts: bool
    enlargement: float
    energy: float
    apart: float
    covered: float
    margin: float | None = None

    @property
    def cost(self) -> float:
        """The less, the better."""
        energy = (_ENERGY_OF_PARTS if self.of_parts else _ENERGY) * self.energy
        return energy + _APART * self.apart + _BARE * (1 - self.covered)


@dataclass(frozen=True, slots=True, eq=False)
class PartMap:
    """A map between parts, and one back.

    Parameters
    ----------
    source, target
        The parts.
    forward, backward : (n,) and (m,)
        The nearest vertex of the other; -1 at vertices without a face.
    rows
        Whose nearest `forward` is.
    alike
        Embeddings, with rows of landmarks if there are any.
    anchors
        Samples that correspond, whose distances the rows have.
    consistent
        See `consistent_share`.
    fit
        How one shape lies on the other when it is deformed along the map; None where it was not.
    """

    source: Part
    target: Part
    forward: IntArray
    backward: IntArray
    rows: Rows
    alike: Rows
    anchors: Anchors
    consistent: float
    fit: PartFit | None = None

    @property
    def scale(self) -> float:
        """Length in the source that is 1 in the target, as taken to be or as measured."""
        here, there = (
            float(np.sqrt(surface_area(each.mesh) / each.spectrum.area))
            for each in (self.source, self.target)
        )
        if self.fit is None:
            return here / there
        return here / there * self.fit.enlargement ** (-1 if self.fit.of_source else 1)

    def probabilities(self) -> tuple[FloatArray, FloatArray]:
        """That each source vertex has a counterpart, and that it is matched rightly, (n,) each.

        Rightly: within 5 % of the whole's diameter of the truth. By logistic regressions, fitted
        to parts of people that the model was not trained on; those of a map along which a shape was
        deformed, to 43 pairs. There, what has a counterpart both lies on the other shape, not
        beyond its rim, and keeps its distances.
        """
        is_closed = float(len(boundary_edges(self.target.mesh)) == 0)
        evidence = _evidence(self)
        if self.fit is None:
            evidence = np.hstack([evidence, _averaged(self.source.mesh, _kept_distances(self))])
            has = _logistic(evidence, _COUNTERPART, _OF_CLOSED * is_closed)
            right = _logistic(evidence, _RIGHT, _OF_SHARE * np.log(self.consistent + 0.1))
        else:
            lying, agreement, share = _lying(self, self.fit)
            closed = np.full((len(lying), 1), is_closed)
            lies = _logistic(np.hstack([lying, evidence[:, 1:2], closed]), _LIES)
            has = lies * _logistic(np.hstack([agreement, closed]), _AGREES)
            margin = _ALONE if self.fit.margin is None else max(self.fit.margin, 0.0)
            clear = np.full((len(lying), 1), min(margin, _CLEAR))
            columns = np.hstack([lying[:, :1], agreement, evidence[:, 1:2], clear])
            # times the probability that no other map is the right one
            agreed = min((share - _DISAGREE) / _AGREE, _AT_MOST)
            right = max(min(margin / _UNCLEAR, 1.0), agreed) * _logistic(columns, _RIGHT_LYING)
            is_close = margin < _CLOSE and not self.fit.of_parts
            if is_close or self._is_unsure(evidence[:, 1], has, of_parts=self.fit.of_parts):
                right *= _UNSURE
        matched = self.forward >= 0
        return np.where(matched, has, 0.0), np.where(matched, right, 0.0)

    def _is_unsure(self, apart: FloatArray, has: FloatArray, *, of_parts: bool) -> bool:
        """Whether what is matched is little alike, or the target is small beside usual errors.

        Parameters
        ----------
        apart : (n,)
            Logarithm of the distance of the matched embeddings.
        has : (n,)
            Probability of a counterpart.
        """
        kept = self.source.spectrum.mass * (has > 0.5)
        unlike = _UNLIKE_PARTS if of_parts else _UNLIKE
        ways = self.target.ways
        diameter = np.max(ways, initial=0.0, where=ways < _BEYOND / 2)
        return bool(kept @ (apart - unlike) > 0 or diameter < _NARROW)


def part_map(source: Part, target: Part, *, landmarks: IntArray | None = None) -> PartMap:
    """The map between parts, and the one back, by embeddings and distances from `anchors`.

    Parameters
    ----------
    landmarks : (l, 2)
        Vertices of both that correspond.
    """
    rows = (source.embedded, target.embedded)
    if landmarks is not None:
        given = (
            landmark_rows(each.mesh, ends)
            for each, ends in zip((source, target), landmarks.T, strict=True)
        )
        rows = _beside(rows, given, _LANDMARK_WEIGHT)
    found = _anchors(source, target, rows, np.arange(len(target.ways)))
    return _anchored(source, target, rows, found, _ANCHOR_WEIGHT)


def other_part_maps(maps: Sequence[PartMap], *, count: int, seed: int = 0) -> list[PartMap]:
    """Maps by other anchors than those of some maps at several sizes, which differ from each other.

    First those that lead nowhere near the best that are known: what is right may be the second
    best, such as the other side of a symmetric shape. Then, best first, some among halves of the
    target's samples: the right ones are often not found among all. Last, the best among fewer
    halves at each of the other sizes, as none may be right at a size that is wrong.

    Parameters
    ----------
    maps
        Best first.
    count
        Of the maps at the size of the first, at most.
    """
    found = maps[0]
    samples = np.arange(len(found.target.ways))
    generator = np.random.default_rng(seed)

    def among_halves(each: PartMap, times: int) -> list[Anchors]:
        halves = [np.flatnonzero(generator.random(len(samples)) < 0.5) for _ in range(times)]
        tried = [_anchors(*_ends(each), half) for half in halves if len(half)]
        return sorted(tried, key=lambda known: -known.agreement)

    tried = among_halves(found, _HALVES)
    best = max((found.anchors, *tried[:1]), key=lambda known: known.agreement)
    ways = _ways_between(found.source, found.target)
    away = _anchors(*_ends(found), samples, away_from=best)
    kept = [(found.anchors, found)]

    def keep(known: Anchors, each: PartMap) -> None:
        if all(_apart(known, other, ways) > _LIKE for other, _ in kept):
            kept.append((known, each))

    for known in tried:
        if len(kept) < count:
            keep(known, found)
    for each in maps[1:]:
        for known in among_halves(each, _FEWER_HALVES)[:1]:
            keep(known, each)
    return [
        _anchored(*_ends(found), away, _AWAY_WEIGHT),
        *(_anchored(*_ends(each), known, _ANCHOR_WEIGHT) for known, each in kept[1:]),
    ]


def _ends(found: PartMap) -> tuple[Part, Part, Rows]:
    return found.source, found.target, found.alike


def _ways_between(source: Part, target: Part) -> FloatArray:
    """Distances between the target's samples, in √area of the larger shape.

    In that unit, which does not depend on the size of the whole, sizes can be compared.
    """
    unit = np.float32(1 / np.sqrt(max(source.spectrum.area, target.spectrum.area)))
    return np.asarray(unit * target.ways[:, target.sample[: len(target.ways)]])


def _apart(one: Anchors, other: Anchors, ways: FloatArray) -> float:
    """Mean distance of where the same samples lead, by their support."""
    weights = one.support * other.support + np.finfo(float).tiny
    return float(np.average(ways[one.target, other.target], weights=weights))


def _anchors(
    source: Part, target: Part, rows: Rows, among: IntArray, away_from: Anchors | None = None
) -> Anchors:
    """Anchors that lead to some of the target's samples, or away from where others lead."""
    here, there = source.sample[:_ANCHORS], target.sample[: len(target.ways)]
    similarity = rows[0][here] @ rows[1][there].T
    unit = np.float32(1 / np.sqrt(max(source.spectrum.area, target.spectrum.area)))
    ways = _ways_between(source, target)
    if away_from is not None:
        similarity[ways[away_from.target] < _AWAY] = _FORBIDDEN
    found = anchors(
        similarity[:, among], unit * source.ways[: len(here)][:, here], ways[np.ix_(among, among)]
    )
    return replace(found, target=among[found.target])


def _anchored(source: Part, target: Part, alike: Rows, found: Anchors, weight: float) -> PartMap:
    """The map by distances from anchors beside embeddings."""
    used = found.support > _SUPPORTED
    ways = source.ways[found.source[used]], target.ways[found.target[used]]
    rows = _beside(alike, map(nearness, ways), weight)
    forward, backward = nearest(*rows)[0], nearest(*rows[::-1])[0]
    share = consistent_share(source, target, forward, backward)
    return PartMap(source, target, forward, backward, rows, alike, found, share)


def refined_part_map(found: PartMap) -> PartMap:
    """The map refined by eigenfunctions, or as it is if that makes it much less consistent.

    The refinement takes the source for a part of the target, and may lose what two parts share.
    """
    forward, rows = _refined(found.source, found.target, found.rows)
    share = consistent_share(found.source, found.target, forward, found.backward)
    if share < found.consistent - _REFINED:
        return found
    return replace(found, forward=forward, rows=rows, consistent=share)


def _refined(source: Part, target: Part, embeddings: Rows) -> tuple[IntArray, Rows]:
    """The nearest target vertex of each source vertex, and the rows by which it is.

    The first functions of the target, as they appear on the source, are fitted by the first of the
    source, as many as its share of the area (Rodolà et al. 2017, *Partial functional
    correspondence*): by least squares at samples, reweighted so that what does not fit counts
    less. The nearest rows of functions and embeddings are the next map.
    """
    sample = source.sample
    at_sample = embeddings[0][sample]
    index, _ = nearest(at_sample, embeddings[1])
    share = min(source.spectrum.area / target.spectrum.area, 1.0)
    here, there = (
        each.spectrum.eigenvectors * np.sqrt(each.spectrum.area) for each in (source, target)
    )
    rows = embeddings
    for size in _SIZES:
        size = min(size, there.shape[1])
        own = min(int(np.ceil(size * share)) + _MORE, here.shape[1])
        fitted, misfit = _fitted(here[sample, :own], there[index, :size])
        apart = np.linalg.norm(at_sample - embeddings[1][index], axis=1)
        weight = _WEIGHT * np.median(misfit) / max(float(np.median(apart)), 1e-6)
        rows = _beside((here[:, :own] @ fitted, there[:, :size]), embeddings, weight)
        index, _ = nearest(rows[0][sample], rows[1])
    return nearest(*rows)[0], rows


def _fitted(basis: FloatArray, wanted: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Coefficients that fit values at samples by a basis, and the misfit of each, (s,)."""
    weights = np.ones(len(basis))
    ridge = _RIDGE * len(basis) * np.eye(basis.shape[1])
    for _ in range(_REWEIGHTINGS):
        weighted = basis * weights[:, None]
        found = np.linalg.solve(weighted.T @ basis + ridge, weighted.T @ wanted)
        misfit = np.linalg.norm(basis @ found - wanted, axis=1)
        weights = 1 / (1 + (misfit / max(float(np.median(misfit)), 1e-9)) ** 2) ** 2
    return found, misfit


def _beside(first: Rows, second: Iterable[FloatArray], weight: float) -> Rows:
    """Rows of both shapes, each with others beside it."""
    source, target = (
        np.hstack([one, weight * other]).astype(np.float32)
        for one, other in zip(first, second, strict=True)
    )
    return source, target


def consistent_share(source: Part, target: Part, forward: IntArray, backward: IntArray) -> float:
    """Area that is mapped there and back, as a share of the smaller area of both.

    Of faces whose corners return to within 0.04, none of whose edges becomes much longer, and
    which keep their orientation; each counts as the smaller of its area and that of its image.
    The smaller of what that is on either shape.
    """
    # images of single faces are rough: a coarser target gives none for many, and more for others
    areas = (
        *_consistent_area(source, target, forward, backward),
        *_consistent_area(target, source, backward, forward),
    )
    return min(areas) / min(source.spectrum.area, target.spectrum.area)


def _consistent_area(
    here: Part, there: Part, index: IntArray, back: IntArray
) -> tuple[float, float]:
    """Area of the faces that count, and of their images."""
    faces = here.mesh.faces
    image = index[faces]
    matched = (image >= 0).all(axis=1)
    faces, image = faces[matched], image[matched]
    near = _missed_by(here, index, back)[faces].max(axis=1) < _NEAR
    both = Mesh(here.points, faces), Mesh(there.points, image)
    length, longer = (edge_lengths(each) for each in both)
    spacing = np.sqrt(there.spectrum.area / np.count_nonzero(there.spectrum.mass))
    smooth = (longer < _STRETCH * (length + spacing)).all(axis=1)
    normals = vertex_normals(there.mesh)[image].sum(axis=1)
    kept = np.einsum("fd,fd->f", face_normals(both[1]), normals) >= 0
    areas = [face_areas(each) for each in both]
    counted = near & smooth & kept
    return float(areas[0][counted].sum()), float(areas[1][counted].sum())


def _missed_by(each: Part, index: IntArray, back: IntArray) -> FloatArray:
    """By how far going there and back misses each vertex, (n,), in √area of the whole."""
    again = np.where(index >= 0, back[index], -1)
    missed = np.linalg.norm(each.points - each.points[again], axis=1)
    return np.where(again >= 0, missed, np.inf)


def _evidence(found: PartMap) -> FloatArray:
    """What speaks for a counterpart of each source vertex, (n, 5), averaged around it.

    Logarithms of: by how far going there and back misses; the distance of the matched embeddings;
    by how far going back and there misses the match; its distance to the target's boundary; and
    how much longer edges become.
    """
    source, target, index = found.source, found.target, found.forward
    rim = np.unique(boundary_edges(target.mesh))
    inside = np.full(len(index), _INSIDE)
    if len(rim):
        inside = KDTree(target.points[rim]).query(target.points[index])[0]
    values = np.stack(
        [
            np.minimum(_missed_by(source, index, found.backward), _LOST),
            np.linalg.norm(source.embedded - target.embedded[index], axis=1),
            np.minimum(_missed_by(target, found.backward, index), _LOST)[index],
            np.minimum(inside, _INSIDE),
        ],
        axis=1,
    )
    pairs = edges(source.mesh)
    lengths = np.zeros((len(index), 2))
    for column, (points, ends) in enumerate(
        ((source.points, pairs), (target.points, index[pairs]))
    ):
        length = np.linalg.norm(points[ends[:, 0]] - points[ends[:, 1]], axis=1)
        for end in pairs.T:
            lengths[:, column] += np.bincount(end, length, minlength=len(index))
    logarithms = np.nan_to_num(np.log(values + _OFFSETS))
    mean = _averaged(source.mesh, np.hstack([logarithms, lengths]))
    longer = np.log((mean[:, 5] + 1e-3) / (mean[:, 4] + 1e-3))
    return np.column_stack([mean[:, :4], longer])


def _lying(found: PartMap, fit: PartFit) -> tuple[FloatArray, FloatArray, float]:
    """Where each source vertex lies, (n, 2), how far it keeps distances, (n, 1), and how many do.

    The logarithm of its height over the target, and by how far it is beyond the target's rim; see
    `esd.matching.anchors.agreement_with_most`. All averaged around it.
    """
    height, beyond = _over_target(found)
    is_open = [len(boundary_edges(each.mesh)) > 0 for each in (found.source, found.target)]
    slack = [_SLACK if each and not all(is_open) else 1.0 for each in is_open]
    places, ways, image = _compared_ways(found)
    agreement, share = agreement_with_most(
        ways, image, places, fit.gap[0][places] < _LYING, slack=(slack[0], slack[1])
    )
    height = np.log(np.minimum(height, _GAP) + _OFFSETS[0])
    beyond = np.clip(beyond / _BEYOND_RIM, -1, 1)
    values = np.nan_to_num(np.stack([height, beyond, agreement], axis=1))
    mean = _averaged(found.source.mesh, values, _FEWER_RINGS)
    return mean[:, :2], mean[:, 2:], share


def _over_target(found: PartMap) -> tuple[FloatArray, FloatArray]:
    """How high over the target each source vertex lies, (n,), and how far beyond its rim, (n,).

    Heights are along the normal of the nearest vertex. Where that is on the rim, what is beyond is
    so along the target, at right angles to the rim; elsewhere it is negative, the distance of the
    nearest vertex from the rim.
    """
    index, sides = found.forward, boundary_edges(found.target.mesh)
    there, normals = np.hsplit(np.nan_to_num(found.rows[1]), 2)
    apart = found.rows[0][:, :3] - there[index]
    height = np.abs((apart * unit(normals)[index]).sum(axis=1))
    if len(sides) == 0:
        return height, np.full(len(index), -_BEYOND_RIM)
    length = there[sides[:, 1]] - there[sides[:, 0]]
    outward = np.zeros_like(there)
    for end in sides.T:
        np.add.at(outward, end, np.cross(length, normals[end]))
    near = adjacency(sides, len(there)) + sparse.eye_array(len(there), format="csr")
    outward = unit(near @ (near @ outward))
    points = found.target.points
    inside = KDTree(points[np.unique(sides)]).query(points)[0][index]
    return height, np.where(inside == 0, (apart * outward[index]).sum(axis=1), -inside)


def _logistic(
    values: FloatArray, weights: tuple[float, ...], offset: float | FloatArray = 0.0
) -> FloatArray:
    constant, *factors = weights
    return np.asarray(1 / (1 + np.exp(-(constant + offset + values @ np.array(factors)))))


def _kept_distances(found: PartMap) -> FloatArray:
    """The agreement of distances on both shapes, of each source vertex, (n, 1)."""
    places, ways, image = _compared_ways(found)
    return agreement(ways, image, places)[:, None]


def _compared_ways(found: PartMap) -> tuple[IntArray, FloatArray, FloatArray]:
    """Some source vertices, the distances of all from these, and those of their images, (k, n)."""
    source, target, index = found.source, found.target, found.forward
    places = source.sample[:_ANCHORS]
    size = np.sqrt(target.spectrum.area / surface_area(target.mesh))
    image = np.minimum(size * geodesic_graph(target.mesh).distances(index[places]), _BEYOND)
    return places, source.ways[: len(places)], image[:, index]


def _averaged(mesh: Mesh, values: FloatArray, rings: int = _RINGS) -> FloatArray:
    """Values (n, c) averaged over neighbours, again and again."""
    near = adjacency(edges(mesh), len(values)) + sparse.eye_array(len(values), format="csr")
    count = near.sum(axis=1)[:, None]
    for _ in range(rings):
        values = (near @ values) / count
    return values
