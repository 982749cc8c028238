"""A template's mesh deformed onto a scan, along a map and to the nearest points of its surface."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from esd.common import BoolArray, FloatArray, InputError, IntArray
from esd.deformation.claims import claims
from esd.deformation.elastic import Elastic, Pull, elastic
from esd.mesh.geometry import adjacency, is_referenced, surface_area, vertex_normals
from esd.mesh.mesh import Mesh, PointCloud
from esd.mesh.surface import closest_points, interpolated, positions
from esd.mesh.topology import boundary_edges, edge_table

_MAP_LENGTHS = (0.3, 0.2, 0.12, 0.08, 0.05, 0.05, 0.05, 0.05)
_SURFACE_LENGTHS = (0.05, 0.05, 0.04, 0.04, 0.03, 0.03, 0.02, 0.02, 0.015, 0.015, 0.01, 0.01)
"""In √area: lengths over which the deformation is stiff, in the rounds of the two stages."""

_FEWEST_MATCHES = 3  # different vertices of the scan by which the template is placed
_FINISHING = 2  # rounds after inverted faces were turned back, which draw them to the surface again
_FINISHING_LENGTH = 0.01

_TRUST = (0.3, 0.04)  # in √area: residual that quarters the weight of a match; first, last round
_TANGENTIAL = 0.05  # weight of a nearest point along the surface, beside that along its normal
_REACH = (0.1, 0.03)  # in √area: farthest nearest point that counts; first and last round
_ORIENTED = 0.1  # in √area: length of the normals beside positions, as nearest points are sought
_UNMATCHED = 0.1  # weight of the claim to a nearest point without a match, beside a sure match
_LEAST_COSINE = 0.5  # of the normals at a vertex and at its nearest point
_WIDTHS = (2, 3, 4, 6)
"""Rings of faces about inverted ones, up to which their surroundings are placed anew, in turn."""

_REPEATS, _STALLED = 4, 2  # of each; after so many in a row that leave no fewer, the next one
_FARTHEST = 0.1  # in √area, by which vertices are moved to turn faces back

_Way = tuple[Callable[[npt.NDArray[np.float64], BoolArray], npt.NDArray[np.float64]], int]
"""What places free vertices anew, and how many rings about inverted faces are free."""


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """A template's vertices on a scan.

    Parameters
    ----------
    vertices : (n, 3)
        In the coordinates of the scan.
    supported : (n,)
        Whether the scan has a nearest point for a vertex; elsewhere it was carried on smoothly.
    scale : float
        Lengths of the scan over those of the template.
    """

    vertices: npt.NDArray[np.float64]
    supported: BoolArray
    scale: float


def fit(
    template: Mesh,
    scan: Mesh | PointCloud,
    target_index: IntArray,
    confidence: FloatArray,
    *,
    start: npt.NDArray[np.float64] | None = None,
    scale: float | None = None,
    quick: bool = False,
) -> Fit:
    """The template's vertices on a scan.

    First the vertices are drawn to their images under the map, robustly; then also to the nearest
    points of the scan's surface, along its normals, where the normals agree. Both are weighed
    against the energy of an as-rigid-as-possible deformation, which becomes softer from round to
    round; it alone decides where the scan has nothing. Of distant parts of the template at one
    place of the scan, only the one with the better claim is drawn there, see
    `esd.deformation.claims`. Last, inverted faces are turned back.

    Parameters
    ----------
    template
        All of its vertices have a face.
    target_index : (n,)
        Scan vertex of each template vertex, -1 for none.
    confidence : (n,)
        Weights of these from 0 to 1; NaN counts as 1.
    start : (n, 3), optional
        Positions to start from, such as those of the frame before. The map may then be empty.
    scale
        Lengths of the scan over those of the template. By default it is 1 where there is a start;
        otherwise it follows from the map.
    quick
        Whether half of the rounds are left out, and inverted faces are left as they are.

    Raises
    ------
    InputError
        If the template has no area, or, without a start, fewer than three vertices of the scan are
        matched, or what is matched has no size.

    References
    ----------
    Sorkine, Alexa 2007, *As-rigid-as-possible surface modeling*. Amberg, Romdhani, Vetter 2007,
    *Optimal step nonrigid ICP algorithms for surface registration* (the rounds).
    """
    weight = np.where(np.isnan(confidence), 1.0, confidence) * (target_index >= 0)
    if start is None and not weight.any():
        raise InputError("No vertex of the template has a match on the scan.")
    images = len(np.unique(target_index[weight > 0]))
    if start is None and images < _FEWEST_MATCHES:
        raise InputError(
            f"The map leads to {images} vertices of the scan; {_FEWEST_MATCHES} or more are "
            "needed to place the template."
        )
    if not surface_area(template) > 0:
        raise InputError("The faces of the template have no area; a surface is needed.")
    image = scan.vertices[target_index]
    body = elastic(template)
    parts = claims(body)
    if start is None:
        unit = (scale or _scale(template, scan, target_index, weight)) * body.unit
        there = _normals(scan)[target_index]
        weight = np.where(parts.contested(image, there, weight, unit=unit), 0.0, weight)
        scale = scale or _scale(template, scan, target_index, weight)
    scale = scale or 1.0
    # stiffness is independent of the scale
    body = replace(body, rest=scale * body.rest, unit=scale * body.unit)
    unit = body.unit

    def matched(vertices: npt.NDArray[np.float64], trust: float) -> npt.NDArray[np.float64]:
        """Weights of the matches, less of those that the others contradict (Geman, McClure)."""
        gap = ((vertices - image) ** 2).sum(axis=1)
        return np.asarray(weight / (1 + gap / (trust * unit) ** 2) ** 2)

    vertices = body.interpolated(image, weight) if start is None else start
    every = 2 if quick else 1
    for share, length in _rounds(_MAP_LENGTHS[::every] if start is None else ()):
        vertices = body.deformed(
            vertices, Pull(image, matched(vertices, _between(_TRUST, share))), length
        )
    surface = _surface(scan, _ORIENTED * unit)

    def deformed_to_surface(
        vertices: npt.NDArray[np.float64], share: float, length: float
    ) -> tuple[npt.NDArray[np.float64], BoolArray]:
        """The vertices after a round, and which of them have a nearest point that is believed."""
        normals = vertex_normals(Mesh(vertices, template.faces))
        near = surface.nearest(vertices, normals, _between(_REACH, share) * unit)
        by_map = matched(vertices, _TRUST[-1])
        gap = np.linalg.norm(near.points - vertices, axis=1)
        claim = near.accepted * (_UNMATCHED + by_map) / (1 + (gap / (_TRUST[-1] * unit)) ** 2) ** 2
        accepted = near.accepted & ~parts.contested(near.points, near.normals, claim, unit=unit)
        along = accepted.astype(float)
        by_map *= 1 - share
        total = by_map + _TANGENTIAL * along
        position = by_map[:, None] * image + (_TANGENTIAL * along)[:, None] * near.points
        position /= np.maximum(total, np.finfo(float).tiny)[:, None]
        height = (near.points * near.normals).sum(axis=1)
        pull = Pull(position, total, near.normals, height, along)
        return body.deformed(vertices, pull, length), accepted

    for share, length in _rounds(_SURFACE_LENGTHS[::every]):
        vertices, accepted = deformed_to_surface(vertices, share, length)
    if quick:
        return Fit(vertices, accepted, scale)
    turned = without_inverted(body, vertices, template.faces)
    at_rest = is_inverted(template)
    for _ in range(_FINISHING):
        is_left = is_inverted(Mesh(turned, template.faces)) & ~at_rest
        if turned is vertices or is_left.any():
            break
        vertices, accepted = deformed_to_surface(turned, 1.0, _FINISHING_LENGTH)
        turned = without_inverted(body, vertices, template.faces)
    return Fit(turned, accepted, scale)


def is_inverted(mesh: Mesh) -> BoolArray:
    """Whether the normal of each face is against the sum of those of its neighbours, (m,).

    Normals are as long as the areas. Faces without area are counted, those without neighbours not.
    """
    table = edge_table(mesh.faces, len(mesh.vertices))
    sides = table.inner_sides() // 3  # of the two faces at each edge
    a, b, c = (mesh.vertices[mesh.faces[:, i]] for i in range(3))
    normal = np.cross(b - a, c - a)
    around = np.zeros_like(normal)
    np.add.at(around, sides[:, 0], normal[sides[:, 1]])
    np.add.at(around, sides[:, 1], normal[sides[:, 0]])
    has_neighbours = np.zeros(len(normal), dtype=bool)
    has_neighbours[sides] = True
    return np.asarray(((normal * around).sum(axis=1) <= 0) & has_neighbours)


def without_inverted(
    body: Elastic, vertices: npt.NDArray[np.float64], faces: IntArray
) -> npt.NDArray[np.float64]:
    """The vertices, (n, 3), with surroundings of inverted faces placed anew, or else flattened.

    No vertex is moved far. Faces that are inverted at rest stay as they are.
    """
    at_rest = is_inverted(Mesh(body.rest, faces))
    start, joined = vertices, adjacency(body.edge, len(vertices))

    def left(vertices: npt.NDArray[np.float64]) -> BoolArray:
        return is_inverted(Mesh(vertices, faces)) & ~at_rest

    def placed_anew(
        vertices: npt.NDArray[np.float64], inverted: BoolArray, way: _Way, *, careful: bool
    ) -> npt.NDArray[np.float64]:
        """The vertices with those patches placed anew that may be so."""
        place, width = way
        free = np.zeros(len(vertices), dtype=bool)
        free[faces[inverted]] = True
        for _ in range(width):
            free = _grown(free, faces)
        if free.all():
            return vertices
        found = place(vertices, free)
        # a face may turn over where its neighbours move: one more ring belongs to a patch
        inside = np.flatnonzero(_grown(free, faces))
        count, label = connected_components(joined[inside][:, inside], directed=False)
        patch = np.full(len(vertices), -1)
        patch[inside] = label
        is_far = np.linalg.norm(found - start, axis=1) > _FARTHEST * body.unit
        refused = np.zeros(count, dtype=bool)
        refused[patch[is_far & free]] = True
        if careful:
            of_face = patch[faces].max(axis=1)  # -1, or the patch of all corners in one
            before, after = (
                np.bincount(of_face[mask & (of_face >= 0)], minlength=count)
                for mask in (inverted, left(found))
            )
            refused |= after > before
        moved = free & ~refused[patch]
        return np.where(moved[:, None], found, vertices)

    best, fewest = vertices, np.inf
    # carelessly first: what adds inverted faces may lead to a state from which all are turned back
    for careful in (False, True):
        vertices = best
        for most in _WIDTHS:
            ways = [(p, width) for p in (body.filled, body.flattened) for width in range(most)]
            stalled = 0
            for _ in range(_REPEATS):
                before = left(vertices).sum()
                for way in ways:
                    inverted = left(vertices)
                    if inverted.sum() < fewest:
                        best, fewest = vertices, inverted.sum()
                    if fewest == 0:
                        return best
                    vertices = placed_anew(vertices, inverted, way, careful=careful)
                stalled = stalled + 1 if left(vertices).sum() >= before else 0
                if stalled == _STALLED:
                    break
        if left(vertices).sum() < fewest:
            best = vertices
    return best


def _grown(chosen: BoolArray, faces: IntArray) -> BoolArray:
    """Vertices, (n,), with those that share a face with them."""
    result = chosen.copy()
    result[faces[chosen[faces].any(axis=1)]] = True
    return result


def _rounds(lengths: tuple[float, ...]) -> list[tuple[float, float]]:
    """Share of the rounds that are done, from 0 to 1, and the length of each."""
    return [(turn / (len(lengths) - 1), length) for turn, length in enumerate(lengths)]


def _between(ends: tuple[float, float], share: float) -> float:
    """A value between two on a logarithmic scale."""
    return float(ends[0] ** (1 - share) * ends[1] ** share)


def _scale(
    template: Mesh, scan: Mesh | PointCloud, target_index: IntArray, weight: npt.NDArray[np.float64]
) -> float:
    """Lengths of the scan over those of the template, by the spread of what is matched."""
    if isinstance(scan, Mesh):
        faces = template.faces[(weight[template.faces] > 0).any(axis=1)]
        sizes = [np.sqrt(surface_area(m)) for m in (Mesh(template.vertices, faces), scan)]
    else:
        matched = weight > 0
        places = template.vertices[matched], scan.vertices[target_index[matched]]
        sizes = [np.sqrt(((x - x.mean(axis=0)) ** 2).sum(axis=1).mean()) for x in places]
    if not min(sizes) > 0:
        raise InputError(
            f"What is matched has no size: {sizes[0]:.3g} on the template and {sizes[1]:.3g} on "
            "the scan; expected surfaces with an area, or points at several places."
        )
    return float(sizes[1] / sizes[0])


@dataclass(frozen=True, slots=True, eq=False)
class _Near:
    """Nearest points (p, 3), the normals there, and whether they are to be believed, (p,)."""

    points: npt.NDArray[np.float64]
    normals: FloatArray
    accepted: BoolArray


@dataclass(frozen=True, slots=True, eq=False)
class _Surface:
    """A scan in which nearest points are sought.

    Parameters
    ----------
    tree
        Of the positions of the vertices `used`, with their normals of length `reach` beside them.
    is_rim : (n,)
        Whether each vertex is at a boundary.
    """

    scan: Mesh | PointCloud
    tree: KDTree
    used: IntArray
    normals: FloatArray
    is_rim: BoolArray
    reach: float

    def nearest(self, points: npt.NDArray[np.float64], normals: FloatArray, reach: float) -> _Near:
        """Nearest points of the surface, believed up to a distance and where normals agree."""
        if isinstance(self.scan, PointCloud):
            distance, index = self.tree.query(points)
            found = self.scan.vertices[index]
            # the points' own normals are not known; those of the template stand for them
            return _Near(found, normals, distance < reach)
        vertex = self.used[self.tree.query(np.hstack([points, self.reach * normals]))[1]]
        place = closest_points(self.scan, points, vertex)
        found = positions(self.scan, place)
        there = interpolated(self.normals, self.scan, place)
        there /= np.maximum(np.linalg.norm(there, axis=1, keepdims=True), np.finfo(float).tiny)
        # what lies beyond a boundary has its nearest point on it, and no counterpart
        is_rim = self.is_rim[self.scan.faces[place.face]]
        beyond = ((place.weights == 0) | is_rim).all(axis=1)
        accepted = (np.linalg.norm(found - points, axis=1) < reach) & ~beyond
        return _Near(found, there, accepted & ((there * normals).sum(axis=1) > _LEAST_COSINE))


def _surface(scan: Mesh | PointCloud, reach: float) -> _Surface:
    count = len(scan.vertices)
    is_rim = np.zeros(count, dtype=bool)
    normals = _normals(scan)
    if isinstance(scan, PointCloud):
        return _Surface(scan, KDTree(scan.vertices), np.arange(count), normals, is_rim, reach)
    used = np.flatnonzero(is_referenced(scan))
    is_rim[boundary_edges(scan)] = True
    tree = KDTree(np.hstack([scan.vertices, reach * normals])[used])
    return _Surface(scan, tree, used, normals, is_rim, reach)


def _normals(scan: Mesh | PointCloud) -> FloatArray:
    """Of the vertices, (n, 3); zero for points, whose normals are not known."""
    return vertex_normals(scan) if isinstance(scan, Mesh) else np.zeros_like(scan.vertices)
