"""Geodesic distances over a surface."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph

from esd.common import FloatArray, InputError, IntArray, install_hint
from esd.mesh.convert import MeshLike, as_mesh
from esd.mesh.geometry import is_referenced
from esd.mesh.mesh import Mesh
from esd.mesh.topology import EdgeTable, edge_table


@dataclass(frozen=True, slots=True, eq=False)
class EdgeGraph:
    """A graph over the vertices of a mesh whose shortest paths approximate geodesics."""

    weights: Any
    """Symmetric sparse matrix (n, n) of lengths."""

    def distances(self, sources: IntArray, *, limit: float = np.inf) -> FloatArray:
        """Distances (s, n) from each source to every vertex, in the mesh's units of length.

        Infinite across components, and beyond `limit`.
        """
        return np.asarray(
            csgraph.dijkstra(self.weights, directed=True, indices=sources, limit=limit)
        )

    def distances_to_any(self, sources: IntArray, *, limit: float = np.inf) -> FloatArray:
        """Distance (n,) of every vertex from the nearest source; infinite without a source."""
        if len(sources) == 0:
            return np.full(self.weights.shape[0], np.inf)
        return np.asarray(
            csgraph.dijkstra(
                self.weights, directed=True, indices=sources, limit=limit, min_only=True
            )
        )

    def nearest_source(self, sources: IntArray) -> IntArray:
        """Which of some vertices is the nearest to each vertex, (n,); -1 where none is reached."""
        _, _, nearest = csgraph.dijkstra(
            self.weights, indices=sources, min_only=True, return_predecessors=True
        )
        return np.maximum(np.asarray(nearest, dtype=np.int64), -1)


def geodesic_graph(mesh: Mesh) -> EdgeGraph:
    """Edges of the mesh, and the straight lines across each pair of neighbouring faces.

    A line across two faces unfolded into a plane is kept where it runs inside them. Its shortest
    paths are too long by about 1 %, those along edges alone by about 5 %.
    """
    table = edge_table(mesh.faces, len(mesh.vertices))
    lengths = np.linalg.norm(np.diff(mesh.vertices[table.ends], axis=1)[:, 0], axis=1)
    across, across_lengths = _unfolded(mesh, table)
    i, j = np.concatenate([table.ends, across]).T
    weight = np.concatenate([lengths, across_lengths])
    # a zero entry would mean 'no edge', but vertices at one place are connected
    weight = np.maximum(weight, np.finfo(float).tiny)
    i, j, weight = _shortest_of_each(i, j, weight)
    size = len(mesh.vertices)
    half = sparse.coo_array((weight, (i, j)), shape=(size, size)).tocsr()
    return EdgeGraph((half + half.T).tocsr())


def _unfolded(mesh: Mesh, table: EdgeTable) -> tuple[IntArray, FloatArray]:
    """Opposite corners of faces that share an edge, and their distance in the common plane."""
    inner = table.inner_sides()  # non-manifold edges are left out
    a, b = table.start[inner[:, 0]], table.end[inner[:, 0]]
    c, d = mesh.faces.ravel()[inner].T  # side 3 f + c lies opposite to corner c of face f
    edge = mesh.vertices[b] - mesh.vertices[a]
    length = np.linalg.norm(edge, axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        along, height = zip(
            *(_plane_coordinates(mesh, a, edge / length[:, None], corner) for corner in (c, d)),
            strict=True,
        )
        crossing = along[0] + (along[1] - along[0]) * height[0] / (height[0] + height[1])
        inside = (crossing > 0) & (crossing < length)
    distance = np.hypot(along[0] - along[1], height[0] + height[1])
    keep = inside & (c != d)
    return np.stack([c, d], axis=1)[keep], distance[keep]


def _plane_coordinates(
    mesh: Mesh, origin: IntArray, direction: FloatArray, corner: IntArray
) -> tuple[FloatArray, FloatArray]:
    """Coordinate of a corner along an edge and its distance from the edge's line."""
    offset = mesh.vertices[corner] - mesh.vertices[origin]
    along = np.einsum("ij,ij->i", offset, direction)
    return along, np.linalg.norm(offset - along[:, None] * direction, axis=1)


def _shortest_of_each(
    i: IntArray, j: IntArray, weight: FloatArray
) -> tuple[IntArray, IntArray, FloatArray]:
    """Undirected pairs once each, with the smallest of their weights."""
    low, high = np.minimum(i, j), np.maximum(i, j)
    order = np.lexsort((weight, high, low))
    low, high, weight = low[order], high[order], weight[order]
    first = np.ones(len(low), dtype=bool)
    first[1:] = (low[1:] != low[:-1]) | (high[1:] != high[:-1])
    return low[first], high[first], weight[first]


def geodesic_distances(mesh: MeshLike, sources: IntArray, *, exact: bool = False) -> FloatArray:
    """Geodesic distances (s, n) from each source to every vertex, in the mesh's units of length.

    Infinite where no path leads.

    Parameters
    ----------
    mesh
        As `esd.match` takes it.
    sources : (s,)
        Vertex indices.
    exact
        Polyhedral distances by the window propagation of Mitchell, Mount and Papadimitriou (1987),
        through pygeodesic, about 60 times slower, instead of shortest paths in `geodesic_graph`,
        which are at most about 1 % longer on average.

    Raises
    ------
    InputError
        If a source is no vertex, or `exact` is asked for without pygeodesic.
    """
    mesh = as_mesh(mesh)
    sources = np.asarray(sources, dtype=np.int64).reshape(-1)
    if len(sources) and not (sources.min() >= 0 and sources.max() < len(mesh.vertices)):
        raise InputError(
            f"`sources` must be from 0 to {len(mesh.vertices) - 1}; "
            f"got {sources.min()} to {sources.max()}."
        )
    if not exact:
        return geodesic_graph(mesh).distances(sources)
    try:
        from pygeodesic import geodesic
    except ImportError as error:
        raise InputError(f"Exact geodesics need pygeodesic: {install_hint('exact')}.") from error
    algorithm = geodesic.PyGeodesicAlgorithmExact(mesh.vertices, mesh.faces)
    everywhere = np.arange(len(mesh.vertices), dtype=np.int32)
    rows = [
        algorithm.geodesicDistances(np.array([source], dtype=np.int32), everywhere)[0]
        for source in sources
    ]
    distances = np.array(rows).reshape(len(sources), len(mesh.vertices))
    return np.where(distances > 1e100, np.inf, distances)


def geodesic_diameter(mesh: Mesh, *, graph: EdgeGraph | None = None, starts: int = 4) -> float:
    """Largest geodesic distance between two vertices of a component, in units of length.

    A lower bound that is nearly always attained: from some vertices, those farthest from each
    other, walks to the farthest vertex go on until the distance grows no more.

    Parameters
    ----------
    graph
        The mesh's `geodesic_graph`, where it is at hand.
    starts
        Number of walks.
    """
    graph = geodesic_graph(mesh) if graph is None else graph
    longest = 0.0
    nearest = np.where(is_referenced(mesh), np.inf, -np.inf)
    for _ in range(starts):
        here = int(np.argmax(nearest))
        first = _reachable(graph.distances(np.array([here]))[0])
        nearest = np.minimum(nearest, np.where(first < 0, np.inf, first))
        reach, distance = float(first.max()), first
        while True:
            distance = _reachable(graph.distances(np.array([int(np.argmax(distance))]))[0])
            if distance.max() <= reach:
                break
            reach = float(distance.max())
        longest = max(longest, reach)
    return longest


def _reachable(distance: FloatArray) -> FloatArray:
    return np.where(np.isfinite(distance), distance, -1.0)
