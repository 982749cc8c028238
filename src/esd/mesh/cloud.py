"""Points without faces: triangles between neighbours, by which they can be drawn and judged."""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph
from scipy.spatial import Delaunay, KDTree, QhullError

from esd.common import FloatArray, InputError, IntArray
from esd.mesh.geometry import unit
from esd.mesh.mesh import Mesh, PointCloud
from esd.mesh.topology import edge_table, with_flipped

_NEIGHBOURS = 12
_LONGEST = 4.0  # times the usual distance of neighbours, beyond which a triangle spans a gap
_THINNEST = 0.01  # area over the longest side squared; 0.43 is equilateral


def surface_between(points: PointCloud) -> Mesh:
    """Triangles between neighbouring points, on all of the points; for pictures, not to measure by.

    Around each point, its nearest neighbours are projected to the plane that fits them best and
    triangulated there. A triangle counts if at least two of its corners find it. The triangles
    overlap here and there and leave small gaps; nearly all of them face outward.

    Raises
    ------
    InputError
        If there is none, as among points on a line, or too few points.
    """
    vertices = points.vertices
    if len(vertices) <= _NEIGHBOURS:
        raise InputError(f"Expected more than {_NEIGHBOURS} points; got {len(vertices)}.")
    gap, around = KDTree(vertices).query(vertices, k=_NEIGHBOURS + 1)
    # of a square, all four corners must choose the same diagonal: none is square after this
    rough = np.random.default_rng(0).normal(scale=1e-3 * np.median(gap[:, 1]), size=vertices.shape)
    rough += vertices
    found = [_fan(rough, near) for near in around]
    faces = np.sort(np.concatenate(found), axis=1)
    faces, times = np.unique(faces, axis=0, return_counts=True)
    faces = faces[times > 1]
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    longest = np.max([np.linalg.norm(p - q, axis=1) for p, q in ((a, b), (b, c), (c, a))], axis=0)
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
    faces = faces[(longest <= _LONGEST * np.median(gap[:, 1:5])) & (area > _THINNEST * longest**2)]
    if len(faces) == 0:
        raise InputError("No surface can be seen between the points; are they on a line?")
    return _facing_outward(Mesh(vertices, faces))


def _facing_outward(mesh: Mesh) -> Mesh:
    """The mesh with normals that vary little along a minimum spanning tree of its faces.

    Edges of three faces, and triangles that overlap, leave no orientation by the sides alone.

    References
    ----------
    Hoppe et al. 1992, *Surface reconstruction from unorganized points*, section 3.3.
    """
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces], 1, 0)
    normals = unit(np.cross(b - a, c - a))
    adjacent = edge_table(mesh.faces, len(mesh.vertices)).adjacent_sides() // 3
    cosine = np.einsum("ij,ij->i", normals[adjacent[:, 0]], normals[adjacent[:, 1]])
    count = len(mesh.faces)
    bend = 1.001 - np.abs(cosine)  # a weight of zero would be no edge of the graph
    graph = sparse.coo_array((bend, tuple(adjacent.T)), shape=(count, count)).tocsr()
    tree = csgraph.minimum_spanning_tree(graph)
    pieces, piece = csgraph.connected_components(tree, directed=False)
    side = np.ones(count)
    for root in np.unique(piece, return_index=True)[1]:
        order, before = csgraph.breadth_first_order(tree, root, directed=False)
        for face in order[1:]:  # each after the one that it follows
            agrees = normals[face] @ normals[before[face]] > 0
            side[face] = side[before[face]] * (1 if agrees else -1)
    # the volume below each triangle, seen from the middle of its piece
    middle = np.stack([np.bincount(piece, m) for m in (a + b + c).T / 3], axis=1)
    centre = (middle / np.bincount(piece)[:, None])[piece]
    volume = side * np.einsum("ij,ij->i", a - centre, np.cross(b - centre, c - centre))
    outward = np.where(np.bincount(piece, volume, minlength=pieces) < 0, -1, 1)
    return with_flipped(mesh, side * outward[piece] < 0)


def _fan(vertices: FloatArray, around: IntArray) -> IntArray:
    """Triangles at the first of some points in their plane, (t, 3)."""
    local = vertices[around] - vertices[around[0]]
    across = np.linalg.svd(local, full_matrices=False)[2][:2]
    try:
        simplices = Delaunay(local @ across.T).simplices
    except QhullError:  # they lie on a line, or at one place
        return np.zeros((0, 3), dtype=np.int64)
    fan: IntArray = around[simplices[(simplices == 0).any(axis=1)]]
    return fan
