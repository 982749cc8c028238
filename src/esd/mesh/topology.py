"""How the faces of a mesh hang together, and meshes that hang together differently."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph

from esd.common import BoolArray, FloatArray, InputError, IntArray
from esd.mesh.geometry import components, edge_lengths, edges, face_areas, is_referenced
from esd.mesh.mesh import Mesh

SLIVER = 0.02
"""`quality` below which a face is a sliver: with an angle of about a degree."""


_SINGLE = 4 * float(np.finfo(np.float32).eps)  # of a coordinate, that writing it may have moved it


@dataclass(frozen=True, slots=True, eq=False)
class Sides:
    """The sides of a mesh's faces, (3 m,), sorted so that those of one edge are adjacent.

    `low` and `high` number the corners (3 · face + corner) at the edge's smaller and larger vertex;
    `count` is the number of faces of the side's edge, and `next` says that the side after it is of
    the same edge.
    """

    face: IntArray
    start: IntArray
    end: IntArray
    low: IntArray
    high: IntArray
    count: IntArray
    next: BoolArray


def sides_of(mesh: Mesh) -> Sides:
    """The sides of a mesh's faces."""
    start, end = mesh.faces[:, [1, 2, 0]].ravel(), mesh.faces[:, [2, 0, 1]].ravel()
    corner = np.arange(3 * len(mesh.faces)).reshape(-1, 3)
    at_start, at_end = corner[:, [1, 2, 0]].ravel(), corner[:, [2, 0, 1]].ravel()
    rising = start < end
    key = np.minimum(start, end) * len(mesh.vertices) + np.maximum(start, end)
    order = np.argsort(key, kind="stable")
    _, inverse, count = np.unique(key[order], return_inverse=True, return_counts=True)
    return Sides(
        face=order // 3,
        start=start[order],
        end=end[order],
        low=np.where(rising, at_start, at_end)[order],
        high=np.where(rising, at_end, at_start)[order],
        count=count[inverse],
        next=np.append(inverse[1:] == inverse[:-1], False),
    )


def _labels(i: IntArray, j: IntArray, size: int) -> IntArray:
    """Connected component of each of `size` nodes of the graph with edges (i, j)."""
    graph = sparse.coo_array((np.ones(len(i), dtype=bool), (i, j)), shape=(size, size))
    return np.asarray(csgraph.connected_components(graph, directed=False)[1], dtype=np.int64)


def seam_partners(mesh: Mesh) -> IntArray:
    """For each vertex on a seam the first that is joined with it there; others themselves, (n,).

    A seam is two open sides between the same two places, but for rounding to single precision: the
    surface is torn along it. Seams whose vertices would join into an edge of more than two faces
    stay open.
    """
    sides = sides_of(mesh)
    _, place = np.unique(mesh.vertices + 0.0, axis=0, return_inverse=True)  # −0 is 0
    place = _joined_places(mesh, place.reshape(-1), sides.start[sides.count == 1])
    ends = np.stack([sides.start, sides.end], axis=1)[sides.count == 1]
    ends = np.take_along_axis(ends, np.argsort(place[ends], axis=1), axis=1)
    ends = ends[place[ends[:, 0]] != place[ends[:, 1]]]
    key = place[ends] @ np.array([len(place), 1])
    order = np.argsort(key, kind="stable")
    _, first, count = np.unique(key[order], return_index=True, return_counts=True)
    i, j = (ends[order[first[count == 2] + k]].ravel() for k in (0, 1))
    while len(i):
        label = _labels(i, j, len(place))
        _, representative = np.unique(label, return_index=True)
        first = representative[label]
        faces = first[mesh.faces]
        faces = faces[~is_collapsed(faces) & ~is_repeated(faces)]
        if len(faces) == 0:
            return first
        joined = sides_of(replace(mesh, faces=faces))
        crowded = np.zeros(len(place), dtype=bool)
        for end in (joined.start, joined.end):
            crowded[end[joined.count > 2]] = True
        # only joins can make edges crowded that were not; those of their vertices are undone
        undone = crowded[first[i]] | crowded[first[j]]
        if not undone.any():
            return first
        i, j = i[~undone], j[~undone]
    return np.arange(len(place))


def _joined_places(mesh: Mesh, place: IntArray, rim: IntArray) -> IntArray:
    """Places of the vertices, (n,), those of a rim that rounding may have moved apart as one."""
    if len(rim) == 0:
        return place
    from scipy.spatial import KDTree  # slow to import

    rim = np.unique(rim)
    points = mesh.vertices[rim]
    # far from the origin double precision may hold what single precision would have lost
    apart = _SINGLE * min(float(np.abs(points).max()), float(np.ptp(points / 2, axis=0).max()) * 2)
    pairs = KDTree(points).query_pairs(apart, p=np.inf, output_type="ndarray")
    if len(pairs) == 0:
        return place
    # vertices of one place are joined anyway; here the places are nodes, and the pairs their edges
    i, j = place[rim[pairs]].T
    return _labels(i, j, int(place.max()) + 1)[place]


def collapse_partners(mesh: Mesh) -> IntArray:
    """For each vertex the first that edges of no length join it with; others themselves, (n,)."""
    short = edges(mesh)
    a, b = mesh.vertices[short[:, 0]], mesh.vertices[short[:, 1]]
    i, j = short[(a == b).all(axis=1)].T
    if len(i) == 0:
        return np.arange(len(mesh.vertices))
    label = _labels(i, j, len(mesh.vertices))
    _, first = np.unique(label, return_index=True)
    return np.asarray(first[label])


def is_collapsed(faces: IntArray) -> BoolArray:
    """Whether each face names a vertex twice, (m,)."""
    a, b, c = faces.T
    return np.asarray((a == b) | (b == c) | (c == a))


def is_repeated(faces: IntArray) -> BoolArray:
    """Whether an earlier face has the same three vertices, in any order, (m,)."""
    corners = np.sort(faces, axis=1)
    order = np.lexsort(corners.T)  # keeps the order of equal faces
    corners = corners[order]
    repeated = np.zeros(len(faces), dtype=bool)
    repeated[order[1:]] = (corners[1:] == corners[:-1]).all(axis=1)
    return repeated


def quality(mesh: Mesh) -> FloatArray:
    """4 √3 area / Σ side² of the faces, (m,): one for equal sides, zero without area."""
    squares = (edge_lengths(mesh) ** 2).sum(axis=1)
    return 4 * 3**0.5 * face_areas(mesh) / np.maximum(squares, np.finfo(float).tiny)


def without_repeats(mesh: Mesh) -> Mesh:
    """The mesh without collapsed faces and with each face once.

    Raises
    ------
    InputError
        If no face is left.
    """
    keep = ~(is_collapsed(mesh.faces) | is_repeated(mesh.faces))
    if not keep.any():
        raise InputError("The mesh has no area: all its faces are degenerate.")
    return replace(mesh, faces=mesh.faces[keep])


def _fan_labels(mesh: Mesh, sides: Sides, *, over: BoolArray) -> IntArray:
    """Fan of each corner, (3 m,): corners of faces that share an edge, `over` those sides."""
    here = np.flatnonzero(over)
    i = np.concatenate([sides.low[here], sides.high[here]])
    j = np.concatenate([sides.low[here + 1], sides.high[here + 1]])
    return _labels(i, j, 3 * len(mesh.faces))


def fan_count(mesh: Mesh, sides: Sides) -> IntArray:
    """Number of fans of faces at each vertex, (n,); a sound surface has one."""
    label = _fan_labels(mesh, sides, over=sides.next)
    _, first = np.unique(label, return_index=True)
    return np.bincount(mesh.faces.ravel()[first], minlength=len(mesh.vertices))


def cut_apart(mesh: Mesh, *, at_edges: bool) -> tuple[Mesh, IntArray]:
    """The mesh with a vertex for each fan of faces, and the original vertex of each vertex.

    The fan of the piece of the largest area keeps the vertex; within a piece, the largest fan.

    Parameters
    ----------
    at_edges
        Whether faces are cut apart at edges that more than two of them share.
    """
    sides = sides_of(mesh)
    whole = sides.next & (sides.count == 2) if at_edges else sides.next
    label = _fan_labels(mesh, sides, over=whole)
    corner = mesh.faces.ravel()
    area = np.bincount(label, weights=np.repeat(face_areas(mesh), 3))
    _, first = np.unique(label, return_index=True)
    vertex = corner[first]
    # fans are the vertices of the cut mesh: two are of one piece where a face has both
    fan = label.reshape(-1, 3)
    piece = _labels(fan[:, [0, 1]].ravel(), fan[:, [1, 2]].ravel(), len(first))
    whole_area = np.bincount(piece, weights=area)[piece]
    order = np.lexsort((-area, -whole_area, vertex))  # fans by vertex, the largest first
    leads = np.ones(len(order), dtype=bool)
    leads[1:] = vertex[order[1:]] != vertex[order[:-1]]
    row = np.empty(len(order), dtype=np.int64)
    row[order[leads]] = vertex[order[leads]]
    row[order[~leads]] = len(mesh.vertices) + np.arange(int((~leads).sum()))
    copied = vertex[order[~leads]]
    cut = Mesh(np.concatenate([mesh.vertices, mesh.vertices[copied]]), row[label].reshape(-1, 3))
    return cut, np.concatenate([np.arange(len(mesh.vertices)), copied])


def patches(mesh: Mesh, sides: Sides) -> tuple[BoolArray, IntArray, BoolArray]:
    """Faces to flip for a consistent orientation, patches of faces, and which are non-orientable.

    Returns (m,), (m,) and (patches,). Faces of non-orientable patches are unchanged.

    Each face is two nodes, itself and itself turned; neighbours that wind alike join equal nodes,
    others unequal ones. A patch with two sides falls into two components, one the other's mirror.
    """
    count = len(mesh.faces)
    here = np.flatnonzero(sides.next & (sides.count == 2))
    f, g = sides.face[here], sides.face[here + 1]
    differ = (sides.start[here] == sides.start[here + 1]) * count
    i, j = np.concatenate([f, f + count]), np.concatenate([g + differ, g + count - differ])
    label = _labels(i, j, 2 * count).reshape(2, count)
    _, patch = np.unique(label.min(axis=0), return_inverse=True)
    patch = patch.reshape(-1)
    one_sided = np.bincount(patch, weights=label[0] == label[1]) > 0
    turned = label[0] > label[1]
    size = np.bincount(patch)
    minority = 2 * np.bincount(patch, weights=turned) > size
    return (turned ^ minority[patch]) & ~one_sided[patch], patch, one_sided


def has_sides(mesh: Mesh) -> bool:
    """Whether the two faces of an edge always wind alike; edges of more faces are not asked."""
    sides = sides_of(mesh)
    here = np.flatnonzero(sides.next & (sides.count == 2))
    return not (sides.start[here] == sides.start[here + 1]).any()


def with_turned(mesh: Mesh, turned: BoolArray) -> Mesh:
    """The mesh with some of its faces, (m,), flipped."""
    if not turned.any():
        return mesh
    return replace(mesh, faces=np.where(turned[:, None], mesh.faces[:, ::-1], mesh.faces))


def is_inward(mesh: Mesh, sides: Sides, patch: IntArray) -> BoolArray:
    """Which patches have their normals inward, (patches,).

    By the sign of the volume they enclose, which is trusted while the rims of their holes are
    together shorter than the root of their area.
    """
    count = patch.max() + 1
    area = np.bincount(patch, weights=face_areas(mesh), minlength=count)
    corners = mesh.vertices[mesh.faces]
    middle = (
        np.stack(
            [np.bincount(patch, weights=corners[:, :, i].mean(axis=1)) for i in range(3)], axis=1
        )
        / np.bincount(patch)[:, None]
    )
    a, b, c = (corners[:, i] - middle[patch] for i in range(3))
    volume = np.bincount(patch, weights=np.einsum("ij,ij->i", a, np.cross(b, c)) / 6)
    open_side = sides.count != 2
    ends = mesh.vertices[sides.start[open_side]] - mesh.vertices[sides.end[open_side]]
    rim = np.bincount(
        patch[sides.face[open_side]], weights=np.linalg.norm(ends, axis=1), minlength=count
    )
    return (volume < -1e-6 * area**1.5) & (rim < area**0.5)


def turned_outward(mesh: Mesh) -> Mesh:
    """The mesh consistently oriented, and closed pieces outward."""
    sides = sides_of(mesh)
    turned, patch, _ = patches(mesh, sides)
    mesh = with_turned(mesh, turned)
    return with_turned(mesh, is_inward(mesh, sides, patch)[patch])


def rims(mesh: Mesh, sides: Sides) -> tuple[IntArray, FloatArray]:
    """Directed edges of one face with the number of their rim, (b, 3), and the rims' lengths."""
    alone = sides.count == 1
    start, end = sides.start[alone], sides.end[alone]
    if len(start) == 0:
        return np.zeros((0, 3), dtype=np.int64), np.zeros(0)
    label = _labels(start, end, len(mesh.vertices))[start]
    _, rim = np.unique(label, return_inverse=True)
    rim = rim.reshape(-1)
    ends = mesh.vertices[start] - mesh.vertices[end]
    length = np.bincount(rim, weights=np.linalg.norm(ends, axis=1))
    return np.stack([start, end, rim], axis=1), np.asarray(length, dtype=float)


def piece_of_faces(mesh: Mesh) -> IntArray:
    """Connected piece of each face, (m,), that with the largest area first."""
    label = components(mesh)[mesh.faces[:, 0]]
    area = np.bincount(label, weights=face_areas(mesh))
    rank = np.empty(len(area), dtype=np.int64)
    rank[np.argsort(-area, kind="stable")] = np.arange(len(area))
    return rank[label]


def largest_piece(mesh: Mesh) -> Mesh:
    """The mesh with only the faces of the connected piece of the largest area."""
    piece = piece_of_faces(mesh)
    return mesh if piece.max() == 0 else replace(mesh, faces=mesh.faces[piece == 0])


def compacted(mesh: Mesh) -> tuple[Mesh, IntArray]:
    """The mesh without vertices that have no face; and what each became, (n,), -1 if removed."""
    used = is_referenced(mesh)
    index = np.where(used, np.cumsum(used) - 1, -1)
    return Mesh(mesh.vertices[used], index[mesh.faces]), index
