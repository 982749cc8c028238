"""Vertices spread over a surface."""

from __future__ import annotations

import numpy as np

from esd.common import FloatArray, InputError, IntArray
from esd.mesh.geodesics import EdgeGraph, geodesic_graph
from esd.mesh.geometry import is_referenced
from esd.mesh.mesh import Mesh


def sample_farthest(
    mesh: Mesh, count: int, *, seed: int = 0, graph: EdgeGraph | None = None
) -> IntArray:
    """Vertices, (count,), each the farthest by geodesic distance from those before it.

    The first is drawn at random. Components are reached in turn, since they are infinitely far
    from each other.

    Parameters
    ----------
    graph
        The mesh's `geodesic_graph`, where it is at hand.

    Raises
    ------
    InputError
        If there are fewer than `count` vertices with a face.
    """
    candidates = np.flatnonzero(is_referenced(mesh))
    if not 1 <= count <= len(candidates):
        raise InputError(f"`count` must be from 1 to {len(candidates)} for this mesh; got {count}.")
    graph = geodesic_graph(mesh) if graph is None else graph
    distance = np.full(len(mesh.vertices), -np.inf)
    distance[candidates] = np.inf
    chosen = np.empty(count, dtype=np.int64)
    chosen[0] = np.random.default_rng(seed).choice(candidates)
    for i in range(1, count):
        np.minimum(distance, graph.distances(chosen[i - 1 : i])[0], out=distance)
        chosen[i] = np.argmax(distance)
    return chosen


def spread(points: FloatArray, count: int) -> IntArray:
    """Some of the points (n, d), (count,), each the farthest in space from those before it.

    The first is the first of the points. All of them if there are fewer.
    """
    chosen = [0]
    distance = ((points - points[0]) ** 2).sum(axis=1)
    while len(chosen) < min(count, len(points)):
        chosen.append(int(distance.argmax()))
        distance = np.minimum(distance, ((points - points[chosen[-1]]) ** 2).sum(axis=1))
    return np.array(chosen)
