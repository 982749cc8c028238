"""Surfaces joined along seams and edges without length, and cut apart where sheets only touch."""

from __future__ import annotations

import numpy as np

from esd.common import IntArray
from esd.mesh.geometry import edges, face_areas
from esd.mesh.mesh import Mesh
from esd.mesh.topology import (
    boundary_edges,
    edge_table,
    fan_labels,
    is_collapsed,
    is_repeated,
    labels,
)

_SINGLE = 4 * float(np.finfo(np.float32).eps)  # of a coordinate, that writing it may have moved it


def seam_partners(mesh: Mesh) -> IntArray:
    """For each vertex on a seam the first that is joined with it there; others themselves, (n,).

    A seam is two open sides between the same two places, but for rounding to single precision: the
    surface is torn along it. Seams whose vertices would join into an edge of more than two faces
    stay open.
    """
    ends = boundary_edges(mesh)
    _, place = np.unique(mesh.vertices + 0.0, axis=0, return_inverse=True)  # −0 is 0
    place = _joined_places(mesh, place.reshape(-1), ends[:, 0])
    ends = np.take_along_axis(ends, np.argsort(place[ends], axis=1), axis=1)
    ends = ends[place[ends[:, 0]] != place[ends[:, 1]]]
    key = place[ends] @ np.array([len(place), 1])
    order = np.argsort(key, kind="stable")
    _, first, count = np.unique(key[order], return_index=True, return_counts=True)
    i, j = (ends[order[first[count == 2] + k]].ravel() for k in (0, 1))
    while len(i):
        label = labels(i, j, len(place))
        _, representative = np.unique(label, return_index=True)
        first = representative[label]
        faces = first[mesh.faces]
        faces = faces[~is_collapsed(faces) & ~is_repeated(faces)]
        if len(faces) == 0:
            return first
        joined = edge_table(faces, len(place))
        crowded = np.zeros(len(place), dtype=bool)
        crowded[joined.ends[joined.count > 2]] = True
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
    return labels(i, j, int(place.max()) + 1)[place]


def collapse_partners(mesh: Mesh) -> IntArray:
    """For each vertex the first that edges of no length join it with; others themselves, (n,)."""
    short = edges(mesh)
    a, b = mesh.vertices[short[:, 0]], mesh.vertices[short[:, 1]]
    i, j = short[(a == b).all(axis=1)].T
    if len(i) == 0:
        return np.arange(len(mesh.vertices))
    label = labels(i, j, len(mesh.vertices))
    _, first = np.unique(label, return_index=True)
    return np.asarray(first[label])


def cut_apart(mesh: Mesh, *, at_edges: bool) -> tuple[Mesh, IntArray]:
    """The mesh with a vertex for each fan of faces, and the original vertex of each vertex.

    The fan of the piece of the largest area keeps the vertex; within a piece, the largest fan.

    Parameters
    ----------
    at_edges
        Whether faces are cut apart at edges that more than two of them share.
    """
    table = edge_table(mesh.faces, len(mesh.vertices))
    whole = table.inner_sides() if at_edges else table.adjacent_sides()
    label = fan_labels(mesh.faces, table, over=whole)
    corner = mesh.faces.ravel()
    area = np.bincount(label, weights=np.repeat(face_areas(mesh), 3))
    _, first = np.unique(label, return_index=True)
    vertex = corner[first]
    # fans are the vertices of the cut mesh: two are of one piece where a face has both
    fan = label.reshape(-1, 3)
    piece = labels(fan[:, [0, 1]].ravel(), fan[:, [1, 2]].ravel(), len(first))
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
