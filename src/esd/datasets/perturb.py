"""Noise of known strength: meshes disturbed in position or connectivity, with exact index maps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.spatial.distance import cdist

from esd.common import InputError, IntArray
from esd.datasets.parts import Perturbed, beyond_plane, check_level, part_with
from esd.mesh.geodesics import geodesic_graph
from esd.mesh.geometry import (
    edge_lengths,
    edges,
    face_areas,
    is_referenced,
    surface_area,
    vertex_normals,
)
from esd.mesh.mesh import Mesh
from esd.mesh.topology import compacted, edge_table, is_collapsed, is_repeated

_HOLES = 10
_APART = 0.3  # least distance along the surface of what is welded, in units of √area
_CHUNK = 256


def geometric_noise(mesh: Mesh, level: float, *, seed: int = 0) -> Perturbed:
    """The mesh with each vertex moved along its normal by Gaussian noise.

    Parameters
    ----------
    level
        Standard deviation in units of the mean edge length.

    Raises
    ------
    InputError
        If the level is negative.
    """
    check_level(level, np.inf)
    generator = np.random.default_rng(seed)
    step = level * edge_lengths(mesh).mean() * generator.standard_normal((len(mesh.vertices), 1))
    return Perturbed(*compacted(Mesh(mesh.vertices + step * vertex_normals(mesh), mesh.faces)))


def holes(mesh: Mesh, level: float, *, seed: int = 0) -> Perturbed:
    """The mesh with ten holes, discs around random points; only the largest piece is kept.

    Parameters
    ----------
    level
        Share of the area that the discs have together where they do not overlap.

    Raises
    ------
    InputError
        If the level is not from 0 to below 1.
    """
    check_level(level, 1)
    area = face_areas(mesh)
    generator = np.random.default_rng(seed)
    centres = generator.choice(len(area), size=_HOLES, p=area / area.sum())
    distance = geodesic_graph(mesh).distances(mesh.faces[centres, 0])
    keep = np.ones(len(area), dtype=bool)
    for row in distance:
        order = np.argsort(row[mesh.faces].mean(axis=1))
        inside = np.cumsum(area[order]) <= level / _HOLES * area.sum()
        keep[order[inside]] = False
    return part_with(mesh, keep)


def edge_flips(mesh: Mesh, level: float, *, seed: int = 0) -> Perturbed:
    """The mesh with random edges turned within the two faces they have.

    An edge is left where its turn would double another edge. No face is touched twice.

    Parameters
    ----------
    level
        Share of the faces that change.

    Raises
    ------
    InputError
        If the level is not from 0 to below 1.
    """
    check_level(level, 1)
    table = edge_table(mesh.faces, len(mesh.vertices))
    inner = table.inner_sides()
    inner = inner[~table.are_alike(inner)]  # only where the faces are consistently oriented
    known = {tuple(edge) for edge in edges(mesh).tolist()}
    faces = mesh.faces.copy()
    touched = np.zeros(len(faces), dtype=bool)
    wanted = level * len(faces)
    for side, other in np.random.default_rng(seed).permutation(inner).tolist():
        if touched.sum() + 2 > wanted:
            break
        f, g = side // 3, other // 3
        a, b = table.start[side], table.end[side]
        c, d = faces[f].sum() - a - b, faces[g].sum() - a - b
        turned = (min(c, d), max(c, d))
        if touched[f] or touched[g] or c == d or turned in known:
            continue
        known.add(turned)
        faces[f], faces[g] = (c, a, d), (d, b, c)
        touched[[f, g]] = True
    return Perturbed(*compacted(Mesh(mesh.vertices, faces)))


def short_circuits(mesh: Mesh, level: float, *, seed: int = 0) -> Perturbed:
    """The mesh with parts welded that are near in space and far along the surface.

    Starting from random places among the nearest tenth, vertices are welded with those opposite, as
    where a scanner took touching limbs for one surface.

    Parameters
    ----------
    level
        Share of the faces that have a welded vertex.

    Raises
    ------
    InputError
        If the level is not from 0 to below 1.
    """
    check_level(level, 1)
    pairs = _near_and_far(mesh)
    first = len(pairs) // 10 + 1
    generator = np.random.default_rng(seed)
    pairs = np.concatenate([generator.permutation(pairs[:first]), pairs[first:]])
    representative = np.arange(len(mesh.vertices), dtype=np.int64)
    degree = np.bincount(mesh.faces.ravel(), minlength=len(mesh.vertices))
    welded = np.zeros(len(mesh.vertices), dtype=bool)
    changed = 0
    for i, j in pairs.tolist():
        if changed >= level * len(mesh.faces):
            break
        if welded[i] or welded[j]:
            continue
        welded[[i, j]] = True
        representative[j] = i
        changed += degree[i] + degree[j]
    vertices = mesh.vertices.copy()
    gone = representative != np.arange(len(representative))
    vertices[representative[gone]] += mesh.vertices[gone]
    vertices[representative[gone]] /= 2
    faces = representative[mesh.faces]
    faces = faces[~(is_collapsed(faces) | is_repeated(faces))]
    result, place = compacted(Mesh(vertices, faces))
    return Perturbed(result, place[representative])


def plane_cut(mesh: Mesh, level: float, *, seed: int = 0) -> Perturbed:
    """The part of a mesh on one side of a plane of random direction; its largest piece.

    Parameters
    ----------
    level
        Share of the area that is cut off.

    Raises
    ------
    InputError
        If the level is not from 0 to below 1.
    """
    return part_with(mesh, beyond_plane(mesh, level, seed=seed))


@dataclass(frozen=True, slots=True)
class Perturbation:
    """A kind of noise: its function, its graded levels, and what they measure."""

    disturb: Callable[..., Perturbed]
    levels: tuple[float, ...]
    unit: str


PERTURBATIONS = {
    "positions": Perturbation(geometric_noise, (0.1, 0.2, 0.4, 0.7, 1.0), "σ / mean edge length"),
    "holes": Perturbation(holes, (0.02, 0.05, 0.1, 0.2, 0.3), "share of the area cut out"),
    "flips": Perturbation(edge_flips, (0.05, 0.1, 0.2, 0.35, 0.5), "share of the faces"),
    "short circuits": Perturbation(
        short_circuits, (0.002, 0.005, 0.01, 0.02, 0.05), "share of the faces"
    ),
    "cut": Perturbation(plane_cut, (0.05, 0.1, 0.2, 0.35, 0.5), "share of the area cut off"),
}
"""The paper names noise in position and connectivity, and no levels; these are ours."""


def _near_and_far(mesh: Mesh) -> IntArray:
    """Each vertex with the nearest in space of those far along the surface, (p, 2), nearest first.

    Raises
    ------
    InputError
        If nothing is far along the surface.
    """
    graph = geodesic_graph(mesh)
    limit = _APART * surface_area(mesh) ** 0.5
    used = np.flatnonzero(is_referenced(mesh))
    pairs, reach = [], []
    for start in range(0, len(used), _CHUNK):
        rows = used[start : start + _CHUNK]
        far = np.isinf(graph.distances(rows, limit=limit)[:, used])
        distance = np.where(far, cdist(mesh.vertices[rows], mesh.vertices[used]), np.inf)
        pairs.append(np.stack([rows, used[distance.argmin(axis=1)]], axis=1))
        reach.append(distance.min(axis=1))
    nearest = np.concatenate(reach)
    order = np.argsort(nearest, kind="stable")[: int(np.isfinite(nearest).sum())]
    if len(order) == 0:
        raise InputError("No two parts of this mesh are far from each other along the surface.")
    return np.concatenate(pairs)[order]
