"""Maps between parts made elastic: one shape deformed onto the other, and the best of several."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from esd.common import FloatArray, InputError, IntArray
from esd.deformation.elastic import elastic
from esd.deformation.fit import Fit, fit
from esd.matching.partial import Part, PartFit, PartMap, consistent_share, other_part_maps
from esd.matching.registered import CoarseMesh, beside, coarse_mesh, weights
from esd.mesh.geometry import edges, is_referenced, surface_area, unit, vertex_normals
from esd.mesh.mesh import Mesh
from esd.mesh.topology import boundary_edges
from esd.nearest import nearest
from esd.parallel import side_by_side

_NORMALS = 0.02  # of unit normals beside positions in √area of the whole, in nearest points
_LYING = 0.03  # in √area of the whole: gap below which shapes count as lying on each other
_LARGEST = 1.15  # factor by which the size is corrected by what is measured
_TRIED = 2  # of the maps that are given, those that fit best
_OTHERS = 7  # maps by other anchors
_SIZES = 5  # of the maps that are given, at which these are sought
_KEPT = (3, 1)  # of which are registered once more, and again
_LIKE = 0.02  # in √area of the whole: mean distance of images below which maps are the same
_ELSEWHERE = 0.05  # and beyond which they differ in more than details


@dataclass(frozen=True, slots=True, eq=False)
class _Sized:
    """A part, the copy of its mesh, and the mesh of that in units of √area of the whole."""

    part: Part
    coarse: CoarseMesh
    mesh: Mesh


def best_registered(maps: Sequence[PartMap]) -> PartMap | None:
    """The best of some maps between two shapes, and others, along which one shape is deformed.

    That which is larger is deformed onto the other, along each of those maps that fit best and
    along some by other anchors; the best again, along what positions and embeddings say then. The
    map of least cost is taken: what bends or stretches little and lays alike places on each other.
    None where the shapes are no oriented manifolds.

    Parameters
    ----------
    maps
        At one or several sizes.
    """
    order = sorted(maps, key=lambda found: -found.consistent - found.anchors.agreement)
    try:
        coarse = coarse_mesh(maps[0].source.mesh), coarse_mesh(maps[0].target.mesh)
    except InputError:
        return None

    def registered(found: PartMap) -> PartMap | None:
        return _registered(_sized(found.source, coarse[0]), _sized(found.target, coarse[1]), found)

    starts = _distinct(order)[:_TRIED] + other_part_maps(order[:_SIZES], count=_OTHERS)
    starts = _distinct(starts)
    made: list[PartMap] = []
    for count in (*_KEPT, 0):
        new = side_by_side(registered, starts)
        made = sorted(made + [found for found in new if found is not None], key=_cost)
        # what became no better is not tried again
        starts = [each for each in _distinct(made, _ELSEWHERE)[:count] if each in new]
    if not made:
        return None
    rivals = [each for each in made if _apart(made[0], each) > _ELSEWHERE]
    margin = min((_cost(each) - _cost(made[0]) for each in rivals), default=None)
    found = made[0]
    assert found.fit is not None
    return replace(found, fit=replace(found.fit, margin=margin))


def _registered(source: _Sized, target: _Sized, found: PartMap) -> PartMap | None:
    """The map of nearest points, one shape deformed along a map; None if that is impossible."""
    is_source = source.part.spectrum.area >= target.part.spectrum.area
    deformed, other = (source, target) if is_source else (target, source)
    maps = _start(found)
    there, back = maps if is_source else maps[::-1]
    scale = 1.0 if found.fit is None else found.fit.enlargement
    near, points = deformed.coarse.near, deformed.part.points
    image = there[near]
    weight = weights(np.linalg.norm(points[near] - points[back[image]], axis=1))
    index = other.coarse.vertex[image]
    try:
        lying = fit(deformed.mesh, other.mesh, index, weight, scale=scale, quick=True)
    except InputError:
        return None
    body = elastic(Mesh(scale * deformed.mesh.vertices, deformed.mesh.faces))
    energy = body.energy(lying.vertices)
    carried = deformed.coarse.copy.carried(lying.vertices).astype(np.float64)
    moved = _rows(Mesh(np.nan_to_num(carried), deformed.part.mesh.faces))
    kept = _rows(Mesh(other.part.points, other.part.mesh.faces))
    (to, gap), (back, other_gap) = nearest(moved, kept), nearest(kept, moved)
    alike = found.alike if is_source else found.alike[::-1]
    forward, backward = (to, back) if is_source else (back, to)
    return replace(
        found,
        forward=forward,
        backward=backward,
        rows=(moved, kept) if is_source else (kept, moved),
        consistent=consistent_share(source.part, target.part, forward, backward),
        fit=PartFit(
            (gap, other_gap) if is_source else (other_gap, gap),
            is_source,
            min(len(boundary_edges(each.part.mesh)) for each in (source, target)) > 0,
            _enlargement(deformed.mesh, lying),
            energy,
            _rows_apart(other.part, alike[1], alike[0][back]),
            _covered(deformed.part, gap, other.part, other_gap),
        ),
    )


def _rows_apart(part: Part, rows: FloatArray, others: FloatArray) -> float:
    """Mean distance of the rows of a part's vertices from others."""
    used = is_referenced(part.mesh)
    distance = np.linalg.norm(rows - others, axis=1)[used]
    return float(np.average(distance, weights=part.spectrum.mass[used]))


def _covered(one: Part, gap: FloatArray, other: Part, other_gap: FloatArray) -> float:
    """Share of the smaller shape that lies on the other, by the lesser of both areas."""
    areas = []
    for part, its_gap in ((one, gap), (other, other_gap)):
        mass = part.spectrum.mass / part.spectrum.mass.sum()
        areas.append(part.spectrum.area * float(mass[its_gap < _LYING].sum()))
    return min(min(areas) / min(one.spectrum.area, other.spectrum.area), 1.0)


def _enlargement(mesh: Mesh, lying: Fit) -> float:
    """How much longer edges have become, as the median of those that lie on the other shape."""
    ends = edges(mesh)
    before, after = (
        np.linalg.norm(points[ends[:, 0]] - points[ends[:, 1]], axis=1)
        for points in (mesh.vertices, lying.vertices)
    )
    counted = lying.supported[ends].all(axis=1) & (before > 0)
    if not counted.any():
        return lying.scale
    return float(np.clip(np.median(after[counted] / before[counted]), 1 / _LARGEST, _LARGEST))


def _start(found: PartMap) -> tuple[IntArray, IntArray]:
    """The map, or what embeddings beside positions make of it where it is of a registration."""
    if found.fit is None:
        return found.forward, found.backward
    source, target = (rows.astype(np.float32) for rows in beside(found.rows, found.alike))
    return nearest(source, target)[0], nearest(target, source)[0]


def _sized(part: Part, coarse: CoarseMesh) -> _Sized:
    """A part with the copy of its mesh, in the units of the part."""
    size = np.sqrt(part.spectrum.area / surface_area(part.mesh))
    mesh = coarse.copy.mesh
    return _Sized(part, coarse, Mesh(size * mesh.vertices, mesh.faces))


def _rows(mesh: Mesh) -> FloatArray:
    """Positions and normals of the vertices, (n, 6); NaN at those without a face."""
    rows = np.hstack([mesh.vertices, _NORMALS * unit(vertex_normals(mesh))])
    rows[~is_referenced(mesh)] = np.nan
    return rows


def _distinct(maps: Sequence[PartMap], apart: float = _LIKE) -> list[PartMap]:
    """The maps but for those that are like one before."""
    found: list[PartMap] = []
    for each in maps:
        if all(_apart(each, other) > apart for other in found):
            found.append(each)
    return found


def _apart(one: PartMap, other: PartMap) -> float:
    """Mean distance of the images of the source's samples, in √area of the whole."""
    sample, points = one.source.sample, one.target.points
    gaps = points[one.forward[sample]] - points[other.forward[sample]]
    return float(np.linalg.norm(gaps, axis=1).mean())


def _cost(found: PartMap) -> float:
    assert found.fit is not None
    return found.fit.cost
