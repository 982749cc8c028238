"""One closed surface around several pieces of a mesh that lie close together.

Characters of games, garments on bodies and exports of CAD are many shells that touch or overlap,
without common vertices. What a viewer takes for one shape is the outside of all of them: the
boundary of the part of space that cannot be reached from far away through gaps narrower than the
cells of a grid.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree

from esd.common import BoolArray, FloatArray
from esd.mesh.geometry import adjacency, components, edge_lengths, edges, face_areas, surface_area
from esd.mesh.mesh import Mesh
from esd.mesh.repair.joining import cut_apart
from esd.mesh.topology import compacted, largest_piece, oriented_outward

_REACHES = (1.0, 2.0, 3.0)  # half the gaps that are closed, in sides of a cell; the least that does
_MARGIN = 5  # cells between the shape and the boundary of the grid, more than the reach
_SAMPLES = 2.0  # samples of the surface along the side of a cell
_MOST_NODES = 2_000_000  # of the grid, without its margin
_MOST_SAMPLES = 2_000_000
_OPEN = 1.4  # times the area of the pieces, from which a surface also lines their inside
_FAR = 4.0  # edges of the surface around, within which a piece belongs to it
_SHRINKING = 0.9  # of the reach, by which the surface moves back to what it wraps
_ROUNDS = 2  # of moving and smoothing

_CELLS = ((1, 1), (0, 1), (0, 0), (1, 0))  # around an edge: before it (1) or not, along two axes


def surface_around(mesh: Mesh, vertex_count: int) -> Mesh | None:
    """The outside of several pieces as one closed surface; None where they enclose nothing.

    Pieces that touch, overlap or nearly touch become one; of what remains apart, the part of the
    largest area is returned. Details smaller than a cell of the grid are lost.

    Parameters
    ----------
    vertex_count
        About the number of vertices of the surface.

    References
    ----------
    Gibson 1998, *Constrained elastic surface nets*.
    """
    from scipy import ndimage  # slow to import

    area = surface_area(mesh)
    used = mesh.vertices[np.unique(mesh.faces)]
    low, size = used.min(axis=0), np.ptp(used, axis=0)
    side = (area / vertex_count) ** 0.5  # a surface crosses about one cell per squared side
    side = max(side, float(np.prod(np.maximum(size, side)) / _MOST_NODES) ** (1 / 3))
    tree = KDTree(_samples(mesh, side / _SAMPLES))
    count = np.ceil(size / side).astype(np.int64) + 2 * _MARGIN + 1
    origin = low - _MARGIN * side
    axes = (origin[axis] + side * np.arange(count[axis]) for axis in range(3))
    nodes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    limit = (_REACHES[-1] + 1) * side
    distance = tree.query(nodes, distance_upper_bound=limit, workers=-1)[0]
    distance = np.minimum(distance, limit).reshape(count)
    for reach in _REACHES:
        field = distance - reach * side
        label, _ = ndimage.label(field > 0)
        # whatever cannot be reached from the corner of the grid is inside
        field = np.where(label == label[0, 0, 0], field, -np.abs(field))
        surface = _isosurface(field)
        surface = replace(surface, vertices=origin + side * surface.vertices)
        surface = largest_piece(cut_apart(surface, at_edges=True)[0])
        surface = _shrunk(compacted(oriented_outward(surface))[0], tree, reach * side)
        # with both of its sides, a sheet that encloses nothing has twice its area
        if surface_area(surface) < _OPEN * area:
            return surface
    return None


def pieces_within(mesh: Mesh, around: Mesh) -> BoolArray:
    """Which faces, (m,), are of pieces that a surface goes around, and of those inside it."""
    piece = components(mesh)
    used = np.flatnonzero(piece >= 0)
    distance = KDTree(around.vertices).query(mesh.vertices[used], workers=-1)[0]
    reached = np.zeros(piece.max() + 1, dtype=bool)
    reached[piece[used[distance <= _FAR * edge_lengths(around).mean()]]] = True
    return np.asarray(reached[piece[mesh.faces[:, 0]]])


def _samples(mesh: Mesh, spacing: float) -> npt.NDArray[np.float64]:
    """Points on the faces, no further apart than some spacing, but at most `_MOST_SAMPLES`.

    Each face is cut along its longest side and towards the corner opposite to it, so that slivers
    get no more than they need.
    """
    corners = mesh.vertices[mesh.faces]
    # side c is opposite to corner c; the longest comes first
    sides = np.linalg.norm(np.roll(corners, -1, axis=1) - np.roll(corners, 1, axis=1), axis=2)
    first = (sides.argmax(axis=1)[:, None] + np.arange(1, 4)) % 3
    a, b, c = np.moveaxis(np.take_along_axis(corners, first[:, :, None], axis=1), 1, 0)
    longest = sides.max(axis=1)
    height = 2 * face_areas(mesh) / np.maximum(longest, np.finfo(float).tiny)
    while True:
        steps = 1 + np.ceil(np.stack([longest, height], axis=1) / spacing).astype(np.int64)
        if steps.prod(axis=1).sum() <= max(_MOST_SAMPLES, 4 * len(steps)):
            break
        spacing *= 2
    points = []
    for along, across in np.unique(steps, axis=0):
        chosen = (steps == (along, across)).all(axis=1)
        s, t = np.meshgrid(np.linspace(0, 1, along), np.linspace(0, 1, across), indexing="ij")
        weights = np.stack([(1 - t) * (1 - s), (1 - t) * s, t], axis=-1).reshape(-1, 3)
        triangles = np.stack([a[chosen], b[chosen], c[chosen]], axis=1)
        points.append(np.einsum("wc,fcx->fwx", weights, triangles).reshape(-1, 3))
    return np.concatenate(points)


def _isosurface(field: FloatArray) -> Mesh:
    """Where a field on a grid crosses zero, by surface nets, in units of its cells.

    A cell whose nodes differ in sign has one vertex, the mean of the crossings on its edges; the
    four cells around an edge of the grid that crosses zero form two faces.
    """
    inside = field < 0
    shape = np.array(field.shape)
    strides = np.array([shape[1] * shape[2], shape[2], 1])
    total = np.zeros((field.size, 3))
    count = np.zeros(field.size)
    quads = []
    for axis in range(3):
        ends = [[slice(None)] * 3 for _ in range(2)]
        ends[0][axis], ends[1][axis] = slice(None, -1), slice(1, None)
        first, second = inside[tuple(ends[0])], inside[tuple(ends[1])]
        at = np.argwhere(first != second)
        # the margin keeps crossings away from the boundary, so that all four cells are there
        a, b = field[tuple(at.T)], field.ravel()[at @ strides + strides[axis]]
        crossing = at.astype(float)
        crossing[:, axis] += a / (a - b)
        u, v = np.delete(np.arange(3), axis) if axis != 1 else (2, 0)
        # around the edge, counterclockwise seen from its end: u and v are the axes after its own
        cells = [at @ strides - du * strides[u] - dv * strides[v] for du, dv in _CELLS]
        for cell in cells:
            np.add.at(total, cell, crossing)
            np.add.at(count, cell, 1.0)
        quad = np.stack(cells, axis=1)
        leaving = first[tuple(at.T)]  # from inside to outside: the face looks along the axis
        quads.append(np.where(leaving[:, None], quad, quad[:, ::-1]))
    quad = np.concatenate(quads)
    faces = np.concatenate([quad[:, [0, 1, 2]], quad[:, [0, 2, 3]]])
    used, faces = np.unique(faces, return_inverse=True)
    return Mesh(total[used] / count[used, None], faces.reshape(-1, 3))


def _shrunk(surface: Mesh, tree: KDTree, reach: float) -> Mesh:
    """The surface moved back by the reach, towards what it wraps, and smoothed a little."""
    vertices = surface.vertices
    near = adjacency(edges(surface), len(vertices))
    degree = np.asarray(near.sum(axis=1)).ravel()
    for _ in range(_ROUNDS):
        distance, index = tree.query(vertices, workers=-1)
        closest = tree.data[index]
        back = np.clip(distance, 0, reach) / np.maximum(distance, np.finfo(float).tiny)
        vertices = vertices + _SHRINKING * back[:, None] * (closest - vertices)
        vertices = 0.5 * vertices + 0.5 * (near @ vertices) / degree[:, None]
    return replace(surface, vertices=vertices)
