"""How the faces of a mesh hang together: edges, fans, orientation, rims, connected pieces."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph

from esd.common import BoolArray, FloatArray, InputError, IntArray
from esd.mesh.geometry import components, edge_lengths, face_areas, is_referenced
from esd.mesh.mesh import Mesh

SLIVER = 0.02
"""`quality` below which a face is a sliver: with an angle of about a degree."""


@dataclass(frozen=True, slots=True, eq=False)
class EdgeTable:
    """The e edges of m faces, and which sides of the faces lie at which edge.

    Side 3 f + c is that of face f opposite to its corner c: it runs from the vertex of corner c + 1
    to that of corner c + 2, modulo 3.

    Parameters
    ----------
    ends : (e, 2)
        Vertices of the edges, the smaller first; sorted.
    count : (e,)
        Number of faces at each edge: one at a boundary, more than two where it is non-manifold.
    of_side : (m, 3)
        The edge of each side.
    start, end : (3 m,)
        Vertices from and to which each side runs.
    by_edge : (3 m,)
        Sides in the order of their edges.
    """

    ends: IntArray
    count: IntArray
    of_side: IntArray
    start: IntArray
    end: IntArray
    by_edge: IntArray

    def open_sides(self) -> IntArray:
        """Sides at edges of one face, (b,), in the order of the edges."""
        return self.by_edge[(np.cumsum(self.count) - 1)[self.count == 1]]

    def inner_sides(self) -> IntArray:
        """The two sides at each edge of exactly two faces, (i, 2), in the order of the edges."""
        first = (np.cumsum(self.count) - 2)[self.count == 2]
        return self.by_edge[np.stack([first, first + 1], axis=1)]

    def adjacent_sides(self) -> IntArray:
        """Pairs of sides at one edge, (a, 2), that link all of its sides: one pair fewer."""
        last = np.zeros(len(self.by_edge), dtype=bool)
        last[np.cumsum(self.count) - 1] = True
        first = np.flatnonzero(~last)
        return self.by_edge[np.stack([first, first + 1], axis=1)]

    def are_alike(self, sides: IntArray) -> BoolArray:
        """Whether pairs of sides at one edge, (k, 2), run the same way: their faces disagree."""
        return np.asarray(self.start[sides[:, 0]] == self.start[sides[:, 1]])


def edge_table(faces: IntArray, vertex_count: int) -> EdgeTable:
    """The edges of some faces, (m, 3), between a number of vertices."""
    start, end = faces[:, [1, 2, 0]].ravel(), faces[:, [2, 0, 1]].ravel()
    # one number an edge, which sorts much faster than pairs
    key = np.minimum(start, end) * vertex_count + np.maximum(start, end)
    by_edge = np.argsort(key, kind="stable")
    key = key[by_edge]
    first = np.flatnonzero(np.append(True, key[1:] != key[:-1])[: len(key)])
    count = np.diff(first, append=len(key))
    of_side = np.empty(len(key), dtype=np.int64)
    of_side[by_edge] = np.repeat(np.arange(len(first)), count)
    ends = np.stack(np.divmod(key[first], max(vertex_count, 1)), axis=1)
    return EdgeTable(ends, count, of_side.reshape(-1, 3), start, end, by_edge)


def boundary_edges(mesh: Mesh) -> IntArray:
    """Directed edges that only one face has, (b, 2)."""
    table = edge_table(mesh.faces, len(mesh.vertices))
    sides = table.open_sides()
    return np.stack([table.start[sides], table.end[sides]], axis=1)


def labels(i: IntArray, j: IntArray, size: int) -> IntArray:
    """Connected component of each of `size` nodes of the graph with edges (i, j)."""
    graph = sparse.coo_array((np.ones(len(i), dtype=bool), (i, j)), shape=(size, size))
    return np.asarray(csgraph.connected_components(graph, directed=False)[1], dtype=np.int64)


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


def fan_labels(faces: IntArray, table: EdgeTable, *, over: IntArray) -> IntArray:
    """Fan of each corner, (3 m,): corners of faces that share an edge, `over` those pairs of sides.

    Parameters
    ----------
    over : (k, 2)
        Pairs of sides at one edge.
    """
    # of side 3 f + c, the numbers 3 f + (c + 1, c + 2 modulo 3) of the corners at start and end
    face, corner = np.divmod(over, 3)
    at_start, at_end = 3 * face + (corner + 1) % 3, 3 * face + (corner + 2) % 3
    alike = table.are_alike(over)
    i = np.concatenate([at_start[:, 0], at_end[:, 0]])
    j = np.concatenate(
        [
            np.where(alike, at_start[:, 1], at_end[:, 1]),
            np.where(alike, at_end[:, 1], at_start[:, 1]),
        ]
    )
    return labels(i, j, faces.size)


def fan_count(faces: IntArray, table: EdgeTable, vertex_count: int) -> IntArray:
    """Number of fans of faces at each vertex, (n,); a sound surface has one."""
    label = fan_labels(faces, table, over=table.adjacent_sides())
    _, first = np.unique(label, return_index=True)
    return np.bincount(faces.ravel()[first], minlength=vertex_count)


def patches(faces: IntArray, table: EdgeTable) -> tuple[BoolArray, IntArray, BoolArray]:
    """Faces to flip for a consistent orientation, patches of faces, and which are non-orientable.

    Returns (m,), (m,) and (patches,). Faces of non-orientable patches are unchanged.

    Each face is two nodes, itself and itself flipped; consistently oriented neighbours join
    equal nodes, others unequal ones. An orientable patch falls into two components, one the other's
    mirror.
    """
    count = len(faces)
    inner = table.inner_sides()
    f, g = inner.T // 3
    # node i is face i, node i + count the same face flipped
    differ = table.are_alike(inner) * count
    i, j = np.concatenate([f, f + count]), np.concatenate([g + differ, g + count - differ])
    label = labels(i, j, 2 * count).reshape(2, count)
    _, patch = np.unique(label.min(axis=0), return_inverse=True)
    patch = patch.reshape(-1)
    non_orientable = np.bincount(patch, weights=label[0] == label[1]) > 0
    flipped = label[0] > label[1]
    size = np.bincount(patch)
    minority = 2 * np.bincount(patch, weights=flipped) > size
    return (flipped ^ minority[patch]) & ~non_orientable[patch], patch, non_orientable


def has_orientation(mesh: Mesh) -> bool:
    """Whether the faces at edges of exactly two are consistently oriented."""
    table = edge_table(mesh.faces, len(mesh.vertices))
    return not table.are_alike(table.inner_sides()).any()


def with_flipped(mesh: Mesh, flipped: BoolArray) -> Mesh:
    """The mesh with some of its faces, (m,), flipped."""
    if not flipped.any():
        return mesh
    return replace(mesh, faces=np.where(flipped[:, None], mesh.faces[:, ::-1], mesh.faces))


def is_inward(mesh: Mesh, table: EdgeTable, patch: IntArray) -> BoolArray:
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
    side = np.flatnonzero(table.count[table.of_side.ravel()] != 2)
    ends = mesh.vertices[table.start[side]] - mesh.vertices[table.end[side]]
    rim = np.bincount(patch[side // 3], weights=np.linalg.norm(ends, axis=1), minlength=count)
    return (volume < -1e-6 * area**1.5) & (rim < area**0.5)


def oriented_outward(mesh: Mesh) -> Mesh:
    """The mesh consistently oriented, and closed pieces outward."""
    table = edge_table(mesh.faces, len(mesh.vertices))
    flipped, patch, _ = patches(mesh.faces, table)
    mesh = with_flipped(mesh, flipped)
    # flipping changes the direction of sides, but not which of them lie at one edge
    return with_flipped(mesh, is_inward(mesh, table, patch)[patch])


def rims(mesh: Mesh, table: EdgeTable) -> tuple[IntArray, FloatArray]:
    """Directed edges of one face with the number of their rim, (b, 3), and the rims' lengths."""
    side = table.open_sides()
    start, end = table.start[side], table.end[side]
    if len(start) == 0:
        return np.zeros((0, 3), dtype=np.int64), np.zeros(0)
    label = labels(start, end, len(mesh.vertices))[start]
    _, rim = np.unique(label, return_inverse=True)
    rim = rim.reshape(-1)
    ends = mesh.vertices[start] - mesh.vertices[end]
    length = np.bincount(rim, weights=np.linalg.norm(ends, axis=1))
    return np.stack([start, end, rim], axis=1), np.asarray(length, dtype=float)


def piece_of_faces(mesh: Mesh) -> IntArray:
    """Connected piece of each face, (m,), that with the largest area first."""
    label = components(mesh)[mesh.faces[:, 0]]
    area = np.bincount(label, weights=face_areas(mesh))
    # rank[i]: the place of piece i when they are sorted by area
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
    index = np.where(used, np.cumsum(used) - 1, -1)  # the number of used vertices before
    return Mesh(mesh.vertices[used], index[mesh.faces]), index
