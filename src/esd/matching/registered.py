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
from esd.mesh.geometry import is_referenced, surface_area, unit, vertex_normals
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
class CoarseMesh:
    """A mesh's copy of few vertices, which is deformed in its place.

    Parameters
    ----------
    copy
        And where the mesh's vertices lie on it.
    near : (c,)
        The vertex of the mesh nearest to each of the copy.
    vertex : (n,)
        The vertex of the copy nearest to each of the mesh; -1 for none.
    """

    copy: MeshCopy
    near: IntArray
    vertex: IntArray


@dataclass(frozen=True, slots=True, eq=False)
class Coarse:
    """A shape with its samples, and the copy of few vertices of its mesh."""

    shape: Sampled
    mesh: CoarseMesh


def coarse_mesh(mesh: Mesh) -> CoarseMesh:
    """A mesh's copy of few vertices.

    Raises
    ------
    InputError
        If it has none, being no oriented manifold.
    """
    copy = coarse_copy(mesh, _VERTICES)
    copy = replace(copy, mesh=compacted(copy.mesh)[0])  # with the same faces in the same order
    used = np.flatnonzero(is_referenced(mesh))
    near = used[KDTree(mesh.vertices[used]).query(copy.mesh.vertices)[1]]
    return CoarseMesh(copy, near, nearest_vertices(copy.mesh, copy.points))


def coarse(shape: Sampled) -> Coarse | None:
    """A shape with its copy; None if it has none, being no oriented manifold."""
    mesh = shape.features.shape
    assert isinstance(mesh, Mesh)  # point clouds have no candidates
    try:
        return Coarse(shape, coarse_mesh(mesh))
    except InputError:
        return None


def weights(miss: FloatArray) -> FloatArray:
    """Of matches that miss by so much, in √area, on the way there and back."""
    return 1 / (1 + (miss / _MISS) ** 2)


def registered(source: Coarse, target: Coarse, candidate: Candidate) -> Candidate | None:
    """The nearest points of the source and the target, the source deformed along a candidate.

    Copies of few vertices are deformed, as `esd.deformation.fit` does; matches that do not return
    count little. None where the candidate leads to too few places to deform by.
    """
    here, there, near = source.shape, target.shape, source.mesh.near
    image = nearest(candidate.forward[0][near], candidate.forward[1])[0]
    again = nearest(candidate.backward[1][image], candidate.backward[0])[0]
    miss = np.linalg.norm(here.points[near] - here.points[again], axis=1)
    index = target.mesh.vertex[image]
    try:
        found = fit(source.mesh.copy.mesh, target.mesh.copy.mesh, index, weights(miss), quick=True)
    except InputError:
        return None
    mesh = there.features.shape
    assert isinstance(mesh, Mesh) and isinstance(here.features.shape, Mesh)
    carried = source.mesh.copy.carried(found.vertices / np.sqrt(surface_area(mesh)))
    points = np.nan_to_num(carried).astype(np.float64)
    normals = unit(vertex_normals(Mesh(points, here.features.shape.faces)))
    rows = (
        np.hstack([points, _NORMALS * normals]),
        np.hstack([there.points, _NORMALS * there.normals]),
    )
    return Candidate(REGISTERED, rows, rows, None)


def with_embeddings(candidate: Candidate, embeddings: Rows) -> Candidate:
    """A registered candidate whose refinement goes by its positions, and by embeddings beside."""
    return replace(candidate, embeddings=beside(candidate.forward, embeddings))


def beside(positions: Rows, embeddings: Rows) -> Rows:
    """Rows of positions with embeddings beside, which are spread half as far."""
    spreads = _spread(positions[1]), _spread(embeddings[1])
    weight = _EMBEDDINGS * spreads[0] / max(spreads[1], np.finfo(float).tiny)
    source, target = (
        np.hstack([position, weight * embedding])
        for position, embedding in zip(positions, embeddings, strict=True)
    )
    return source, target


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
