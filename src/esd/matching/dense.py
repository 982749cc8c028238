"""Maps between dense meshes by way of coarse copies of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial import KDTree

from esd.common import FloatArray, IntArray
from esd.matching.correspondence import Correspondence
from esd.mesh.geometry import surface_area, vertex_normals
from esd.mesh.surface import SurfacePoints, interpolated
from esd.spectral.coarse import MeshCopy

_MOTIONS = 3  # affine fits, each to the nearest vertices after the one before
_CONGRUENT = 0.3  # of the distance between vertices, within which most of them then lie
_MOST = 0.9
_BEYOND = 3.0  # times the distance between vertices of the copy, a motion far from the map
_TORN = 5.0  # times its own size, beyond which the image of a face lies across a tear of the map


def carried_to_dense(
    match: Correspondence,
    image: SurfacePoints,
    source: MeshCopy,
    target: MeshCopy,
) -> Correspondence:
    """The map between dense meshes that a map between their copies gives.

    A vertex of the dense source lies in a face of its copy. The images of the corners of that face
    are interpolated, and the dense target vertex nearest to there, in place and normal, is its
    match. Where the map is torn at that face, the image of the nearest corner is taken. Where an
    affine motion lays one dense mesh on the other, its nearest vertices are.

    Parameters
    ----------
    match
        From the source's copy to the target's; its distances and confidences are interpolated.
    image
        The same map, to points of the target's copy.
    """
    # nearness in position and normal keeps matches on their side of a finger
    reach = np.sqrt(surface_area(target.mesh) / len(target.mesh.vertices))
    oriented = np.hstack([target.mesh.vertices, reach * vertex_normals(target.mesh)])
    there = interpolated(oriented, target.mesh, image)
    source = _not_across_tears(source, there, surface_area(target.mesh))
    known, reached = (np.flatnonzero(copy.points.face >= 0) for copy in (source, target))
    candidates = target.carried(oriented)[reached]
    candidates[:, :3] = target.vertices[reached]
    index = np.full(len(source.points.face), -1, dtype=np.int64)
    sought = source.carried(there)[known]
    near = np.asarray(KDTree(candidates).query(sought, workers=-1)[1])
    places, normals = candidates[:, :3], candidates[:, 3:] / reach
    spacing = reach * np.sqrt(len(target.mesh.vertices) / len(reached))
    near = _laid_on(source.vertices[known], places, normals, near, spacing=spacing, reach=reach)
    index[known] = reached[near]
    distance, confidence = (source.carried(x) for x in (match.distance, match.confidence))
    return Correspondence(
        index,
        np.where(index >= 0, distance, np.inf),
        np.where(index >= 0, confidence, 0.0),
        match.judgement,
    )


def _laid_on(
    source: FloatArray,
    target: FloatArray,
    normals: FloatArray,
    index: IntArray,
    *,
    spacing: float,
    reach: float,
) -> IntArray:
    """The nearest target vertices, (n,), after the affine motion that a map is closest to.

    Where that does not lay the source, (n, 3), on the target's surface, or leads elsewhere than the
    map, the map itself.

    Parameters
    ----------
    target, normals : (m, 3)
    spacing, reach
        The distance between vertices of the target, and of its copy.
    """
    rows = np.hstack([source, np.ones((len(source), 1))])

    def moved_by(found: IntArray) -> FloatArray:
        return rows @ np.linalg.lstsq(rows, target[found], rcond=None)[0]

    moved, found = moved_by(index), index
    if np.quantile(np.linalg.norm(moved - target[index], axis=1), _MOST) > _BEYOND * reach:
        return index  # before all vertices are searched
    tree = KDTree(target)
    for _ in range(_MOTIONS):
        moved = moved_by(found)
        found = np.asarray(tree.query(moved, workers=-1)[1])
    height = np.abs(np.einsum("ij,ij->i", moved - target[found], normals[found]))
    away = np.linalg.norm(target[found] - target[index], axis=1)
    is_near = np.quantile(height, _MOST) < _CONGRUENT * spacing and np.quantile(away, _MOST) < reach
    return found if is_near else index


def _not_across_tears(source: MeshCopy, there: FloatArray, area: float) -> MeshCopy:
    """The copy with dense vertices moved to a corner of their face where its image is torn."""
    faces = source.mesh.faces
    size, stretched = (
        np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
        for corners in (source.mesh.vertices[faces], there[faces, :3])
    )
    scale = np.sqrt(area / surface_area(source.mesh))
    torn = (stretched > _TORN * scale * size)[source.points.face, None]
    corner = np.eye(3)[np.nan_to_num(source.points.weights).argmax(axis=1)]
    weights = np.where(torn, corner, source.points.weights)
    return replace(source, points=replace(source.points, weights=weights))
