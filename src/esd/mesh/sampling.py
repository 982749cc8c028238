"""Samples of a surface's vertices."""

from __future__ import annotations

import numpy as np

from esd.common import InputError, IntArray
from esd.mesh.geodesics import EdgeGraph, geodesic_graph
from esd.mesh.geometry import is_referenced, vertex_areas
from esd.mesh.mesh import Mesh


def sample_by_area(mesh: Mesh, count: int, *, seed: int = 0) -> IntArray:
    """Distinct vertices, (count,), drawn with probability proportional to their area.

    Raises
    ------
    InputError
        If there are fewer than `count` vertices with area.
    """
    area = vertex_areas(mesh)
    _check_count(count, int((area > 0).sum()))
    generator = np.random.default_rng(seed)
    return generator.choice(len(area), size=count, replace=False, p=area / area.sum())


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
    _check_count(count, len(candidates))
    graph = geodesic_graph(mesh) if graph is None else graph
    distance = np.full(len(mesh.vertices), -np.inf)
    distance[candidates] = np.inf
    chosen = np.empty(count, dtype=np.int64)
    chosen[0] = np.random.default_rng(seed).choice(candidates)
    for i in range(1, count):
        np.minimum(distance, graph.distances(chosen[i - 1 : i])[0], out=distance)
        chosen[i] = np.argmax(distance)
    return chosen


def _check_count(count: int, available: int) -> None:
    if not 1 <= count <= available:
        raise InputError(f"`count` must be from 1 to {available} for this mesh; got {count}.")
