"""A candidate map made elastic: the source deformed onto the target along it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import KDTree

from esd.common import FloatArray, InputError, IntArray
from esd.deformation.fit import fit
from esd.matching.candidates import (
    FROM_POSE,
    Candidate,
    Rows,
    Sampled,
    sample_maps,
    spectral_candidate,
)
from esd.mesh.geometry import surface_area, unit, vertex_normals
from esd.mesh.mesh import Mesh
from esd.mesh.surface import nearest_vertices
from esd.mesh.topology import compacted
from esd.nearest import nearest
from esd.spectral.coarse import MeshCopy, coarse_copy

REGISTERED = "registered"
"""Name of the candidate."""

_VERTICES = 1200  # of the copies that are deformed
_MISS = 0.05  # in √area: a way there and back that misses by so much halves the weight of a match
_NORMALS = 0.02  # of unit normals beside positions in √area, in nearest points
_EMBEDDINGS = 0.5  # of embeddings beside positions, as their spreads are made equal


@dataclass(frozen=True, slots=True, eq=False)
class Coarse:
    """A shape with a copy of few vertices, which is deformed in its place.

    Parameters
    ----------
    shape
        With its samples.
    copy
        And where the shape's vertices lie on it.
    near : (c,)
        The vertex of the shape nearest to each of the copy.
    vertex : (n,)
        The vertex of the copy nearest to each of the shape; -1 for none.
    """

    shape: Sampled
    copy: MeshCopy
    near: IntArray
    vertex: IntArray


def coarse(shape: Sampled) -> Coarse | None:
    """A shape with its copy; None if it has none, being no oriented manifold."""
    mesh = shape.features.shape
    assert isinstance(mesh, Mesh)  # point clouds have no candidates
    try:
        copy = coarse_copy(mesh, _VERTICES)
    except InputError:
        return None
    copy = replace(copy, mesh=compacted(copy.mesh)[0])  # with the same faces in the same order
    near = KDTree(mesh.vertices).query(copy.mesh.vertices)[1]
    return Coarse(shape, copy, near, nearest_vertices(copy.mesh, copy.points))


def registered(source: Coarse, target: Coarse, candidate: Candidate) -> Candidate | None:
    """The nearest points of the source and the target, the source deformed along a candidate.

    Copies of few vertices are deformed, as `esd.deformation.fit` does; matches that do not return
    count little. None where the candidate leads to too few places to deform by.
    """
    here, there = source.shape, target.shape
    image = nearest(candidate.forward[0][source.near], candidate.forward[1])[0]
    again = nearest(candidate.backward[1][image], candidate.backward[0])[0]
    miss = np.linalg.norm(here.points[source.near] - here.points[again], axis=1)
    index = target.vertex[image]
    weight = 1 / (1 + (miss / _MISS) ** 2)
    try:
        found = fit(source.copy.mesh, target.copy.mesh, index, weight, quick=True)
    except InputError:
        return None
    mesh = there.features.shape
    assert isinstance(mesh, Mesh) and isinstance(here.features.shape, Mesh)
    carried = source.copy.carried(found.vertices / np.sqrt(surface_area(mesh)))
    points = np.nan_to_num(carried).astype(np.float64)
    normals = unit(vertex_normals(Mesh(points, here.features.shape.faces)))
    rows = (
        np.hstack([points, _NORMALS * normals]),
        np.hstack([there.points, _NORMALS * there.normals]),
    )
    return Candidate(REGISTERED, rows, rows, None)


def with_embeddings(candidate: Candidate, embeddings: Rows) -> Candidate:
    """A registered candidate whose refinement goes by its positions, and by embeddings beside."""
    spreads = [_spread(rows) for rows in (candidate.forward[1], embeddings[1])]
    weight = _EMBEDDINGS * spreads[0] / max(spreads[1], np.finfo(float).tiny)
    beside = tuple(
        np.hstack([position, weight * embedding])
        for position, embedding in zip(candidate.forward, embeddings, strict=True)
    )
    return replace(candidate, embeddings=(beside[0], beside[1]))


def smoothed(source: Sampled, target: Sampled, candidate: Candidate) -> Candidate:
    """A registered candidate refined coarsely, from which it can be registered once more."""
    assert candidate.embeddings is not None
    start = sample_maps(source, target, candidate)
    return spectral_candidate(
        REGISTERED, source, target, candidate.embeddings, start=start, sizes=FROM_POSE
    )


def _spread(rows: FloatArray) -> float:
    """Root mean square distance of rows from their mean, but for NaN: vertices without a face."""
    return float(np.sqrt(np.nanmean(((rows - np.nanmean(rows, axis=0)) ** 2).sum(axis=1))))
