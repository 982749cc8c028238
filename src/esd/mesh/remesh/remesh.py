"""The same surface with other triangles, in several styles, and which points correspond.

The method is the dual of a geodesic Voronoi diagram. Sites are spread over a refinement of the
surface, every vertex of the refinement goes to its nearest site along the surface, and three sites
whose cells meet become a triangle. Where the cells are too large to follow the surface (a cell
around a whole finger, say), the dual would not be a manifold: sites are added there until it is.
Then edges are flipped and vertices moved along the surface until the triangles are as wished. New
vertices lie on the old surface, and where is known.

Only NumPy and SciPy are needed. The small mesh libraries there are decimate, which leaves traces
of the old triangles and sometimes edges of four faces, or move vertices off the surface without
saying where they came from.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import sparse
from scipy.sparse import csgraph
from scipy.spatial import cKDTree

from esd.common import BoolArray, FloatArray, InputError, IntArray
from esd.mesh.geometry import (
    components,
    edges,
    face_areas,
    is_consistently_oriented,
    is_referenced,
    surface_area,
    vertex_areas,
    vertex_normals,
)
from esd.mesh.mesh import Mesh

FINENESS = 2.0  # mean distance of sites over longest edge of the refinement
SMOOTHING = 8  # averages of the curvature over neighbours before it guides the density
SLIVER = 2.5  # sum of cotangents opposite to an edge, below minus which its triangles are slivers
DENSEST = 4.0  # times shorter, or longer, than usual that edges may be
REPAIRS = 60  # rounds of adding sites; three are usual
POOR = 0.05  # quality of a triangle, 1 if equilateral, below which its corners are moved
REPAIR_ROUNDS = 4  # rounds of moving them
WALK = 3  # vertices further on that the place nearest to a point may lie


@dataclass(frozen=True, slots=True)
class Style:
    """What the triangles are like.

    Parameters
    ----------
    grading : float
        Power of the curvature by which edges are shorter where the surface bends, up to four
        times. 0 for triangles of equal size.
    stretch : float
        Ratio of the sides of the triangles, the longer along the direction of least bending.
    spreading : int
        Rounds in which each site moves to the middle of its cell.
    relaxing : int
        Rounds in which edges are flipped and vertices move to the middle of their triangles.
    """

    grading: float = 0.0
    stretch: float = 1.0
    spreading: int = 3
    relaxing: int = 3


STYLES = {
    "graded": Style(grading=0.65),
    "even": Style(),
    "adaptive": Style(grading=1.0),
    "stretched": Style(grading=0.3, stretch=2.5, relaxing=0),
    "rough": Style(grading=0.3, spreading=0, relaxing=0),
}
"""Styles by name: 'graded' varies as the shapes of FAUST_r do, 'rough' is a careless sampling."""


@dataclass(frozen=True, slots=True, eq=False)
class Remeshed:
    """A surface with new triangles; n new vertices, p old ones.

    Parameters
    ----------
    mesh : Mesh
        The new mesh, its vertices on the old surface.
    face : (n,)
        Face of the old mesh on which each new vertex lies.
    barycentric : (n, 3)
        Its barycentric coordinates there.
    nearest : (p,)
        New vertex nearest to each old vertex, -1 for old vertices without a face.
    """

    mesh: Mesh
    face: IntArray
    barycentric: FloatArray
    nearest: IntArray


def remesh(mesh: Mesh, vertex_count: int, *, style: str | Style = "graded", seed: int) -> Remeshed:
    """The surface with about `vertex_count` vertices in a style.

    The new mesh has the topology and the orientation of the old one. It may have some vertices
    more than asked for where they are needed to follow the surface. Equal seeds give equal meshes.

    Parameters
    ----------
    mesh : Mesh
        A manifold, consistently oriented mesh, closed or open.
    vertex_count : int
        At least 4.
    style
        A name in `STYLES`, or a `Style`.
    seed : int
        Of the places of the vertices.

    Raises
    ------
    InputError
        If the count is too small, the style unknown, or the mesh not an oriented manifold.
    """
    style = _checked(mesh, vertex_count, style)
    spacing = np.sqrt(2 / np.sqrt(3) * surface_area(mesh) / vertex_count)
    fine = _refined(mesh, spacing / FINENESS)
    density, metric = _density_and_metric(mesh, fine, style)
    sites = _spread_sites(fine, density, metric, vertex_count, style.spreading, seed)
    sites, cell, faces = _dual(fine, metric, sites)
    excess = 0.0 if style.relaxing else SLIVER
    motion = _Motion.on(fine, density, len(sites))
    place = _at_sites(fine, sites)
    for _ in range(style.relaxing):
        place, faces = _relaxed(motion, place, faces, excess=excess, everywhere=True)
    for _ in range(REPAIR_ROUNDS):
        if not _is_poor(place.positions(fine), faces, place.normals(fine)).any():
            break
        place, faces = _relaxed(motion, place, faces, excess=excess, everywhere=False)
    vertices = place.positions(fine)
    faces = _flipped(vertices, faces, place.normals(fine), excess=excess)
    new = Mesh(vertices, faces)
    face = fine.parent[place.face]
    return Remeshed(
        mesh=new,
        face=face,
        barycentric=barycentric_coordinates(vertices, mesh.vertices[mesh.faces[face]]),
        nearest=_walked(new, mesh.vertices, cell[: len(mesh.vertices)]),
    )


def _checked(mesh: Mesh, vertex_count: int, style: str | Style) -> Style:
    if vertex_count < 4:
        raise InputError(f"`vertex_count` must be at least 4; got {vertex_count}.")
    if not is_consistently_oriented(mesh) or _fan_count(mesh.faces, len(mesh.vertices)).max() > 1:
        raise InputError(
            "The mesh must be a consistently oriented manifold to be remeshed; repair it first."
        )
    if (face_areas(mesh) == 0).all():
        raise InputError("The mesh has no area; there is no surface to remesh.")
    if isinstance(style, Style):
        return style
    if style not in STYLES:
        raise InputError(f"`style` must be one of {', '.join(STYLES)}; got '{style}'.")
    return STYLES[style]


# The refinement


@dataclass(frozen=True, slots=True, eq=False)
class _Fine:
    """The refined surface: mesh, old face of each face, normals, edges, border, faces by vertex."""

    mesh: Mesh
    parent: IntArray
    normals: FloatArray
    edges: IntArray
    rim: IntArray
    around: sparse.csr_array


def _refined(mesh: Mesh, longest: float) -> _Fine:
    """The surface with edges halved until none is longer; old vertices keep their numbers."""
    vertices, faces = mesh.vertices, mesh.faces
    parent = np.arange(len(faces))
    while True:
        pairs, side = _edges_and_sides(faces, len(vertices))
        long = np.linalg.norm(np.diff(vertices[pairs], axis=1)[:, 0], axis=1) > longest
        if not long.any():
            break
        middle = np.where(long, len(vertices) + np.cumsum(long) - 1, -1)[side]
        vertices = np.vstack([vertices, vertices[pairs[long]].mean(axis=1)])
        faces, parent = _split(vertices, faces, middle, parent)
    fine = Mesh(vertices, faces)
    normals = vertex_normals(fine)
    return _Fine(fine, parent, normals, pairs, _rim(pairs, side), _faces_around(faces))


def _faces_around(faces: IntArray) -> sparse.csr_array:
    """Faces of each vertex, as the columns of its row."""
    corners = (np.arange(3 * len(faces)) // 3, faces.ravel())
    return sparse.coo_array((np.ones(3 * len(faces)), corners[::-1])).tocsr()


def _edges_and_sides(faces: IntArray, vertex_count: int) -> tuple[IntArray, IntArray]:
    """Edges, (e, 2), and the edge opposite to each corner, (m, 3)."""
    start, end = faces[:, [1, 2, 0]].ravel(), faces[:, [2, 0, 1]].ravel()
    key, side = np.unique(
        np.minimum(start, end) * vertex_count + np.maximum(start, end), return_inverse=True
    )
    return np.stack([key // vertex_count, key % vertex_count], axis=1), side.reshape(-1, 3)


def _rim(pairs: IntArray, side: IntArray) -> IntArray:
    """Edges with one face, (b, 2)."""
    return np.asarray(pairs[np.bincount(side.ravel(), minlength=len(pairs)) == 1])


def _split(
    vertices: FloatArray, faces: IntArray, middle: IntArray, parent: IntArray
) -> tuple[IntArray, IntArray]:
    """Faces cut at the middles of their sides, (m, 3), -1 where a side stays whole."""
    count = (middle >= 0).sum(axis=1)
    pieces, parents = [faces[count == 0]], [parent[count == 0]]

    def add(chosen: BoolArray, *triangles: tuple[IntArray, IntArray, IntArray]) -> None:
        for triangle in triangles:
            pieces.append(np.stack(triangle, axis=1))
            parents.append(parent[chosen])

    chosen = count == 3
    (a, b, c), (bc, ca, ab) = faces[chosen].T, middle[chosen].T
    add(chosen, (a, ab, ca), (ab, b, bc), (ca, bc, c), (bc, ca, ab))
    for turn in range(3):
        corner, halved = np.roll(faces, -turn, axis=1), np.roll(middle, -turn, axis=1)
        chosen = (count == 1) & (halved[:, 0] >= 0)
        (a, b, c), bc = corner[chosen].T, halved[chosen, 0]
        add(chosen, (a, b, bc), (a, bc, c))
        chosen = (count == 2) & (halved[:, 0] < 0)
        (a, b, c), (_, ca, ab) = corner[chosen].T, halved[chosen].T
        # the quadrangle ab-b-c-ca, cut along its shorter diagonal
        across = np.linalg.norm(vertices[ab] - vertices[c], axis=1)
        shorter = across < np.linalg.norm(vertices[b] - vertices[ca], axis=1)
        add(
            chosen,
            (a, ab, ca),
            (ab, b, np.where(shorter, c, ca)),
            (np.where(shorter, ab, b), c, ca),
        )
    return np.concatenate(pieces), np.concatenate(parents)


# Density and metric


def _density_and_metric(
    mesh: Mesh, fine: _Fine, style: Style
) -> tuple[FloatArray, sparse.csr_array]:
    """How much closer than usual vertices should be, and lengths of the edges that say so."""
    bending = _bending(mesh)[mesh.faces].mean(axis=1)
    # an old face for each vertex of the refinement; whichever, for vertices without one
    any_face = np.minimum(fine.around.indptr[:-1], len(fine.around.indices) - 1)
    face = fine.parent[fine.around.indices[any_face]]
    curvature = np.sqrt(np.trace(bending, axis1=1, axis2=2))
    median = np.median(curvature)
    density = np.ones(len(face))
    if style.grading > 0 and median > 0:
        relative = (curvature / median).clip(1e-3) ** style.grading
        density = relative.clip(1 / DENSEST, DENSEST)[face]
    start, end = fine.edges.T
    step = fine.mesh.vertices[end] - fine.mesh.vertices[start]
    squared = (step**2).sum(axis=1)
    if style.stretch > 1:
        across = np.linalg.eigh(bending)[1][:, :, 2]  # of most bending
        crossing = (step * across[face[start]]).sum(axis=1)
        squared = squared + (style.stretch**2 - 1) * crossing**2
    length = np.sqrt(squared) * (density[start] + density[end]) / 2
    size = len(fine.mesh.vertices)
    half = sparse.coo_array((length, (start, end)), shape=(size, size))
    return density, (half + half.T).tocsr()


def _bending(mesh: Mesh) -> FloatArray:
    """Squared change of the normal per length in all directions, smoothed, (n, 3, 3)."""
    pairs, normals = edges(mesh), vertex_normals(mesh)
    step = np.diff(mesh.vertices[pairs], axis=1)[:, 0]
    change = np.diff(normals[pairs], axis=1)[:, 0]
    squared = (step**2).sum(axis=1)
    tensor = change[:, :, None] * change[:, None, :]
    tensor /= np.where(squared > 0, squared, np.inf)[:, None, None]
    size = len(mesh.vertices)
    ends = sparse.coo_array(
        (np.ones(2 * len(pairs)), (pairs.T.ravel(), np.tile(np.arange(len(pairs)), 2))),
        shape=(size, len(pairs)),
    ).tocsr()
    degree = np.maximum(ends.sum(axis=1), 1)[:, None]
    bending = ends @ tensor.reshape(-1, 9) / degree
    for _ in range(SMOOTHING):
        bending = (ends @ (ends.T @ bending)) / (2 * degree)
    return np.asarray(bending.reshape(-1, 3, 3))


# Sites and their dual


def _spread_sites(
    fine: _Fine,
    density: FloatArray,
    metric: sparse.csr_array,
    count: int,
    rounds: int,
    seed: int,
) -> IntArray:
    """Vertices of the refinement, drawn by density and moved to the middles of their cells."""
    mass = vertex_areas(fine.mesh) * density**2
    count = min(count, int((mass > 0).sum()))
    sites = np.random.default_rng(seed).choice(
        len(mass), size=count, replace=False, p=mass / mass.sum()
    )
    for _ in range(rounds):
        cell, _ = _cells(metric, sites)
        inside = cell >= 0
        total = np.bincount(cell[inside], mass[inside], len(sites))
        middle = np.stack(
            [
                np.bincount(cell[inside], (mass * x)[inside], len(sites)) / total
                for x in fine.mesh.vertices.T
            ],
            axis=1,
        )
        gap = ((fine.mesh.vertices - middle[cell]) ** 2).sum(axis=1)
        sites = _first_of_each(cell, gap)
    return np.sort(sites)


def _cells(metric: sparse.csr_array, sites: IntArray) -> tuple[IntArray, FloatArray]:
    """Number of the nearest site along the edges, -1 where there is none, and its distance."""
    distance, _, source = csgraph.dijkstra(
        metric, indices=sites, min_only=True, return_predecessors=True
    )
    number = np.full(metric.shape[0] + 1, -1)
    number[sites] = np.arange(len(sites))
    return number[np.maximum(source, -1)], distance


def _first_of_each(cell: IntArray, value: FloatArray) -> IntArray:
    """Member of each cell with the least value, in the order of the cells."""
    order = np.lexsort((value, cell))
    order = order[cell[order] >= 0]
    return order[np.flatnonzero(np.diff(cell[order], prepend=-1))]


def _dual(
    fine: _Fine, metric: sparse.csr_array, sites: IntArray
) -> tuple[IntArray, IntArray, IntArray]:
    """Sites, the cell of each vertex of the refinement, and the triangles of sites.

    Sites are added where their triangles are no manifold or face inward.
    """
    referenced = is_referenced(fine.mesh)
    for _ in range(REPAIRS):
        cell, distance = _cells(metric, sites)
        corners = cell[fine.mesh.faces]
        meets = (corners != np.roll(corners, 1, axis=1)).all(axis=1) & (corners >= 0).all(axis=1)
        faces = corners[meets]
        bad = _is_folded(faces, cell[fine.rim], len(sites))
        turned = _is_turned(fine.mesh.vertices[sites], faces, fine.normals[sites])
        bad[faces[turned]] = True
        grown = np.union1d(sites, _first_of_each(cell, -distance)[bad])
        missed = referenced & (cell < 0)
        if missed.any():  # a component without a site
            piece = np.where(missed, components(fine.mesh), -1)
            grown = np.union1d(grown, _first_of_each(piece, distance))
        if len(grown) == len(sites):
            return sites, cell, faces
        sites = grown
    raise InputError(
        f"The surface cannot be followed with about {len(sites)} vertices; ask for more."
    )


def _is_folded(faces: IntArray, rim: IntArray, count: int) -> BoolArray:
    """Whether the triangles at each site fail to be a disc, (count,).

    `rim` are pairs of sites whose cells meet at the border of the surface: their edge may have one
    triangle.
    """
    bad = np.bincount(faces.ravel(), minlength=count) == 0
    sides = faces[:, [[1, 2], [2, 0], [0, 1]]].reshape(-1, 2)
    key, times = np.unique(sides[:, 0] * count + sides[:, 1], return_counts=True)
    back = key % count * count + key // count
    open_key = np.concatenate([rim[:, 0] * count + rim[:, 1], rim[:, 1] * count + rim[:, 0]])
    wrong = key[(times > 1) | ~(np.isin(back, key) | np.isin(key, open_key))]
    _, which, times = np.unique(
        np.sort(faces, axis=1), axis=0, return_inverse=True, return_counts=True
    )
    bad[wrong // count] = bad[wrong % count] = True
    bad[faces[times[which.ravel()] > 1]] = True
    return np.asarray(bad | (_fan_count(faces, count) > 1))


def _fan_count(faces: IntArray, count: int) -> IntArray:
    """Number of fans of triangles around each vertex, (count,): one where it is a manifold."""
    start, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    key = start * count + end
    order = np.argsort(key, kind="stable")
    opposite = order[np.searchsorted(key[order], end * count + start).clip(0, len(key) - 1)]
    paired = np.flatnonzero(key[opposite] == end * count + start)
    # the corner at the start of a side, and the corner of the same vertex across the side
    across = opposite[paired] // 3 * 3 + (opposite[paired] % 3 + 1) % 3
    links = sparse.coo_array((np.ones(len(paired)), (paired, across)), shape=(len(key), len(key)))
    fans, label = csgraph.connected_components(links, directed=False)
    owner = np.empty(fans, dtype=np.int64)
    owner[label] = start
    return np.bincount(owner, minlength=count)


# Places on the refinement, and moving them


@dataclass(frozen=True, slots=True, eq=False)
class _Place:
    """Points on the refinement: face and barycentric coordinates."""

    face: IntArray
    barycentric: FloatArray

    def of(self, fine: _Fine, values: FloatArray) -> FloatArray:
        """Values of vertices, interpolated."""
        return np.einsum("ni,ni...->n...", self.barycentric, values[fine.mesh.faces[self.face]])

    def positions(self, fine: _Fine) -> npt.NDArray[np.float64]:
        return self.of(fine, fine.mesh.vertices).astype(np.float64)

    def normals(self, fine: _Fine) -> FloatArray:
        normals = self.of(fine, fine.normals)
        length = np.linalg.norm(normals, axis=1, keepdims=True)
        return np.asarray(normals / np.where(length > 0, length, 1))

    def where(self, chosen: BoolArray, other: _Place) -> _Place:
        """Own places where chosen, the other's elsewhere."""
        return _Place(
            np.where(chosen, self.face, other.face),
            np.where(chosen[:, None], self.barycentric, other.barycentric),
        )


def _at_sites(fine: _Fine, sites: IntArray) -> _Place:
    face = fine.around.indices[fine.around.indptr[sites]].astype(np.int64)
    return _Place(face, (fine.mesh.faces[face] == sites[:, None]).astype(np.float64))


@dataclass(frozen=True, slots=True, eq=False)
class _Motion:
    """What moving along the refinement needs: a search tree in space and normal."""

    fine: _Fine
    density: FloatArray
    reach: float
    tree: cKDTree

    @classmethod
    def on(cls, fine: _Fine, density: FloatArray, count: int) -> _Motion:
        # nearness in position and normal keeps vertices on their side of a finger
        reach = float(np.sqrt(surface_area(fine.mesh) / count) / 2)
        tree = cKDTree(np.hstack([fine.mesh.vertices, reach * fine.normals]))
        return cls(fine, density, reach, tree)

    def nearest_place(self, points: FloatArray, normals: FloatArray) -> _Place:
        """Nearest place to each point on the faces around the nearest vertex."""
        vertex = self.tree.query(np.hstack([points, self.reach * normals]))[1]
        return _Place(*_nearest_place(self.fine.mesh, self.fine.around, points, vertex))


def _relaxed(
    motion: _Motion, place: _Place, faces: IntArray, *, excess: float, everywhere: bool
) -> tuple[_Place, IntArray]:
    """Places moved along the surface to the middle of their triangles, edges flipped.

    All of them, or only the corners of poor triangles; never those on the border.
    """
    fine = motion.fine
    vertices, normals = place.positions(fine), place.normals(fine)
    faces = _flipped(vertices, faces, normals, excess=excess)
    moving = np.full(len(vertices), everywhere)
    if not everywhere:
        moving[faces[_is_poor(vertices, faces, normals)]] = True
    moving[_rim(*_edges_and_sides(faces, len(vertices)))] = False
    step = _middles(vertices, faces, place.of(fine, motion.density)) - vertices
    step -= (step * normals).sum(axis=1, keepdims=True) * normals
    moved = motion.nearest_place(vertices + step, normals).where(moving, place)
    before = _is_turned(vertices, faces, normals)
    for _ in range(3):  # take back what turns a triangle over
        turned = _is_turned(moved.positions(fine), faces, moved.normals(fine)) & ~before
        moving[faces[turned]] = False
        moved = moved.where(moving, place)
    return moved, faces


def _is_poor(vertices: npt.NDArray[np.float64], faces: IntArray, normals: FloatArray) -> BoolArray:
    """Whether triangles are slivers or flipped."""
    corners = vertices[faces]
    squared = ((corners - np.roll(corners, 1, axis=1)) ** 2).sum(axis=(1, 2))
    area = face_areas(Mesh(vertices, faces))
    return np.asarray(
        (4 * np.sqrt(3) * area < POOR * squared) | _is_turned(vertices, faces, normals)
    )


def _is_turned(
    vertices: npt.NDArray[np.float64], faces: IntArray, normals: FloatArray
) -> BoolArray:
    """Whether triangles face against the normals of all their corners, or have no area."""
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    normal = np.cross(b - a, c - a)
    return np.asarray((np.einsum("mk,mik->mi", normal, normals[faces]) <= 0).all(axis=1))


def _middles(vertices: npt.NDArray[np.float64], faces: IntArray, density: FloatArray) -> FloatArray:
    """Centre of mass of the triangles at each vertex, dense ones weighing more."""
    mass = face_areas(Mesh(vertices, faces)) * density[faces].mean(axis=1) ** 2
    centre = vertices[faces].mean(axis=1)
    owner = faces.ravel()
    total = np.bincount(owner, np.repeat(mass, 3), len(vertices))
    sums = [np.bincount(owner, np.repeat(mass * x, 3), len(vertices)) for x in centre.T]
    return np.asarray(np.stack(sums, axis=1) / np.where(total > 0, total, 1)[:, None])


def nearest_place(mesh: Mesh, points: FloatArray, vertex: IntArray) -> tuple[IntArray, FloatArray]:
    """Face (p,) and barycentric coordinates (p, 3) of the place nearest to each point.

    It is looked for among the faces at a vertex, and goes on to those at another corner as long as
    the place lies opposite to the vertex.

    Parameters
    ----------
    points : (p, 3)
    vertex : (p,)
        Vertex of the mesh, with a face, near each point.
    """
    around = _faces_around(mesh.faces)
    face, barycentric = _nearest_place(mesh, around, points, vertex)
    moving, start = np.arange(len(points)), vertex
    for _ in range(WALK):
        corners = mesh.faces[face[moving]]
        opposite = (barycentric[moving] * (corners == start[:, None])).sum(axis=1) == 0
        nearest = barycentric[moving].argmax(axis=1)
        moving, start = moving[opposite], corners[opposite, nearest[opposite]]
        face[moving], barycentric[moving] = _nearest_place(mesh, around, points[moving], start)
    return face, barycentric


def _nearest_place(
    mesh: Mesh, around: sparse.csr_array, points: FloatArray, vertex: IntArray
) -> tuple[IntArray, FloatArray]:
    first, last = around.indptr[vertex], around.indptr[vertex + 1]
    face = np.empty(len(points), dtype=np.int64)
    barycentric = np.zeros((len(points), 3))
    least = np.full(len(points), np.inf)
    for turn in range(int((last - first).max(initial=0))):
        candidate = around.indices[np.minimum(first + turn, last - 1)]
        triangle = mesh.vertices[mesh.faces[candidate]]
        weights = nearest_in_triangle(points, triangle)
        gap = ((np.einsum("ni,nik->nk", weights, triangle) - points) ** 2).sum(axis=1)
        closer = gap < least
        face[closer], barycentric[closer], least[closer] = (
            candidate[closer],
            weights[closer],
            gap[closer],
        )
    return face, barycentric


def barycentric_coordinates(points: FloatArray, triangles: FloatArray) -> FloatArray:
    """Barycentric coordinates of points in the planes of triangles, (n, 3).

    Parameters
    ----------
    points : (n, 3)
    triangles : (n, 3, 3)
        Corners of the triangle of each point; those without area give the middle.
    """
    a, b, c = triangles.transpose(1, 0, 2)
    normal = np.cross(b - a, c - a)
    squared = (normal**2).sum(axis=1)
    second = (np.cross(points - a, c - a) * normal).sum(axis=1)
    third = (np.cross(b - a, points - a) * normal).sum(axis=1)
    weights = np.stack([squared - second - third, second, third], axis=1)
    flat = squared == 0
    weights[flat] = 1
    return np.asarray(weights / np.where(flat, 3, squared)[:, None])


def nearest_in_triangle(points: FloatArray, triangles: FloatArray) -> FloatArray:
    """Barycentric coordinates of the point of a triangle nearest to each point, (n, 3).

    Parameters
    ----------
    points : (n, 3)
    triangles : (n, 3, 3)
        Corners of the triangle of each point.
    """
    inside = barycentric_coordinates(points, triangles)
    nearest = inside.copy()
    gap = ((np.einsum("ni,nik->nk", inside, triangles) - points) ** 2).sum(axis=1)
    least = np.where((inside >= 0).all(axis=1), gap, np.inf)
    for corner in range(3):
        first, second = (corner + 1) % 3, (corner + 2) % 3
        start, side = triangles[:, first], triangles[:, second] - triangles[:, first]
        squared = (side**2).sum(axis=1)
        share = ((points - start) * side).sum(axis=1) / np.where(squared > 0, squared, 1)
        share = share.clip(0, 1)
        gap = ((start + share[:, None] * side - points) ** 2).sum(axis=1)
        closer = gap < least
        least[closer] = gap[closer]
        nearest[closer] = 0
        nearest[closer, first] = 1 - share[closer]
        nearest[closer, second] = share[closer]
    return nearest


def _flipped(
    vertices: npt.NDArray[np.float64],
    faces: IntArray,
    normals: FloatArray,
    *,
    excess: float,
    rounds: int = 8,
) -> IntArray:
    """Faces with edges flipped whose opposite cotangents sum to less than minus `excess`.

    Zero gives Delaunay triangles. Edges stay where the surface is sharp, or where a flip would
    double an edge or turn a triangle over.
    """
    count = len(vertices)
    for _ in range(rounds):
        start, end = np.roll(faces, -1, axis=1).ravel(), np.roll(faces, -2, axis=1).ravel()
        key = start * count + end
        order = np.argsort(key, kind="stable")
        opposite = order[np.searchsorted(key[order], end * count + start).clip(0, len(key) - 1)]
        side = np.flatnonzero((key[opposite] == end * count + start) & (start < end))
        one, two = side, opposite[side]
        a, b = start[one], end[one]
        c, d = faces.ravel()[one], faces.ravel()[two]
        weight = _cotangent(vertices, c, a, b) + _cotangent(vertices, d, a, b)
        wanted = np.flatnonzero(weight < -excess - 1e-9)
        exists = np.isin(c[wanted] * count + d[wanted], key)
        exists |= np.isin(d[wanted] * count + c[wanted], key)
        wanted = wanted[~exists]
        a, b, c, d = (x[wanted] for x in (a, b, c, d))
        left, right = np.stack([c, a, d], axis=1), np.stack([c, d, b], axis=1)
        safe = ~(_is_turned(vertices, left, normals) | _is_turned(vertices, right, normals))
        flat = _cosine(vertices, np.stack([c, a, b], axis=1), np.stack([d, b, a], axis=1)) > 0.5
        chosen = np.flatnonzero(safe & flat)
        if len(chosen) == 0:
            break
        # of flips that touch the same triangle, the most needed is done
        chosen = chosen[np.argsort(weight[wanted[chosen]], kind="stable")]
        touched = np.stack([one[wanted], two[wanted]], axis=1)[chosen] // 3
        rank = np.full(len(faces), len(chosen))
        np.minimum.at(rank, touched, np.arange(len(chosen))[:, None])
        free = (rank[touched] == np.arange(len(chosen))[:, None]).all(axis=1)
        chosen, touched = chosen[free], touched[free]
        pair = np.minimum(c, d)[chosen] * count + np.maximum(c, d)[chosen]
        _, single = np.unique(pair, return_index=True)
        faces = faces.copy()
        faces[touched[single, 0]] = left[chosen[single]]
        faces[touched[single, 1]] = right[chosen[single]]
    return faces


def _cotangent(vertices: FloatArray, corner: IntArray, a: IntArray, b: IntArray) -> FloatArray:
    """Cotangent of the angle at a corner between two other vertices; huge where it is flat."""
    one, two = vertices[a] - vertices[corner], vertices[b] - vertices[corner]
    area = np.linalg.norm(np.cross(one, two), axis=1)
    return np.asarray((one * two).sum(axis=1) / np.maximum(area, np.finfo(float).tiny))


def _cosine(vertices: FloatArray, first: IntArray, second: IntArray) -> FloatArray:
    """Cosine of the angle between the normals of triangles; 1 where one has no area."""
    one, two = (
        np.cross(vertices[f[:, 1]] - vertices[f[:, 0]], vertices[f[:, 2]] - vertices[f[:, 0]])
        for f in (first, second)
    )
    length = np.linalg.norm(one, axis=1) * np.linalg.norm(two, axis=1)
    product = (one * two).sum(axis=1)
    return np.divide(product, length, out=np.ones(len(one)), where=length > 0)


def _walked(mesh: Mesh, points: npt.NDArray[Any], start: IntArray) -> IntArray:
    """Nearest vertex to each point that is reached by descending from a vertex, -1 from -1."""
    pairs = edges(mesh)
    both = np.vstack([pairs, pairs[:, ::-1]])
    both = both[np.argsort(both[:, 0], kind="stable")]
    degree = np.bincount(both[:, 0], minlength=len(mesh.vertices))
    first = np.cumsum(degree) - degree
    current = start.copy()
    while True:
        best, least = current, ((mesh.vertices[current] - points) ** 2).sum(axis=1)
        for turn in range(degree.max()):
            slot = np.minimum(first[current] + turn, first[current] + degree[current] - 1)
            neighbour = both[slot, 1]
            gap = ((mesh.vertices[neighbour] - points) ** 2).sum(axis=1)
            best = np.where(gap < least, neighbour, best)
            least = np.minimum(gap, least)
        best = np.where(start < 0, -1, best)
        if (best == current).all():
            return best
        current = best
