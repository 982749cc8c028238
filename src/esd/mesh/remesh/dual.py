"""Sites spread over a refinement, and the triangles between those whose cells meet."""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph

from esd.common import BoolArray, FloatArray, InputError, IntArray
from esd.mesh.geometry import components, is_referenced, vertex_areas
from esd.mesh.remesh.flipping import is_inverted
from esd.mesh.remesh.refinement import Refinement
from esd.mesh.topology import edge_table, fan_count

REPAIRS = 60  # rounds of adding sites; three are usual


def spread_sites(
    fine: Refinement,
    density: FloatArray,
    metric: sparse.csr_array,
    count: int,
    rounds: int,
    seed: int,
) -> IntArray:
    """Vertices of the refinement, drawn by density and moved to the middles of their cells."""
    mass = vertex_areas(fine.mesh) * density**2
    count = min(count, int((mass > 0).sum()))
    sites = np.random.default_rng(seed).choice(
        len(mass), size=count, replace=False, p=mass / mass.sum()
    )
    for _ in range(rounds):
        cell, _ = _cells(metric, sites)
        inside = cell >= 0
        total = np.bincount(cell[inside], mass[inside], len(sites))
        middle = np.stack(
            [
                np.bincount(cell[inside], (mass * x)[inside], len(sites)) / total
                for x in fine.mesh.vertices.T
            ],
            axis=1,
        )
        gap = ((fine.mesh.vertices - middle[cell]) ** 2).sum(axis=1)
        sites = _first_of_each(cell, gap)
    return np.sort(sites)


def _cells(metric: sparse.csr_array, sites: IntArray) -> tuple[IntArray, FloatArray]:
    """Number of the nearest site along the edges, -1 where there is none, and its distance."""
    distance, _, source = csgraph.dijkstra(
        metric, indices=sites, min_only=True, return_predecessors=True
    )
    number = np.full(metric.shape[0] + 1, -1)
    number[sites] = np.arange(len(sites))
    return number[np.maximum(source, -1)], distance


def _with_more(
    metric: sparse.csr_array,
    sites: IntArray,
    grown: IntArray,
    cell: IntArray,
    distance: FloatArray,
) -> tuple[IntArray, FloatArray]:
    """The `_cells` of all sites from those of some: only what lies around the others changes.

    Parameters
    ----------
    sites, grown
        Sorted; the latter contain the former.
    """
    more = np.setdiff1d(grown, sites)
    reached = np.isfinite(distance)
    # where no site was reached the way may be any length
    limit = float(distance[reached].max()) if reached.all() else np.inf
    nearer, _, source = csgraph.dijkstra(
        metric, indices=more, min_only=True, return_predecessors=True, limit=limit
    )
    number = np.full(metric.shape[0], -1)
    number[grown] = np.arange(len(grown))
    cell = np.where(cell >= 0, number[sites[cell]], -1)  # by the new numbers
    closer = nearer < distance
    cell[closer] = number[source[closer]]
    return cell, np.minimum(nearer, distance)


def _first_of_each(cell: IntArray, value: FloatArray) -> IntArray:
    """Member of each cell with the least value, in the order of the cells."""
    # by cell, and within a cell by value: the first of each cell has the least
    order = np.lexsort((value, cell))
    order = order[cell[order] >= 0]
    return order[np.flatnonzero(np.diff(cell[order], prepend=-1))]


def dual(
    fine: Refinement, metric: sparse.csr_array, sites: IntArray
) -> tuple[IntArray, IntArray, IntArray]:
    """Sites, the cell of each vertex of the refinement, and the triangles of sites.

    Sites are added where their triangles are no manifold or face inward.
    """
    referenced = is_referenced(fine.mesh)
    cell, distance = _cells(metric, sites)
    for _ in range(REPAIRS):
        corners = cell[fine.mesh.faces]
        meets = (corners != np.roll(corners, 1, axis=1)).all(axis=1) & (corners >= 0).all(axis=1)
        faces = corners[meets]
        bad = _is_folded(faces, cell[fine.rim], len(sites))
        inverted = is_inverted(fine.mesh.vertices[sites], faces, fine.normals[sites])
        bad[faces[inverted]] = True
        in_bad = np.flatnonzero(bad[cell] & (cell >= 0))
        grown = np.union1d(sites, in_bad[_first_of_each(cell[in_bad], -distance[in_bad])])
        missed = referenced & (cell < 0)
        if missed.any():  # a component without a site
            piece = np.where(missed, components(fine.mesh), -1)
            grown = np.union1d(grown, _first_of_each(piece, distance))
        if len(grown) == len(sites):
            return sites, cell, faces
        cell, distance = _with_more(metric, sites, grown, cell, distance)
        sites = grown
    raise InputError(
        f"The surface cannot be followed with about {len(sites)} vertices; ask for more."
    )


def _is_folded(faces: IntArray, rim: IntArray, count: int) -> BoolArray:
    """Whether the triangles at each site fail to be a disc, (count,).

    `rim` are pairs of sites whose cells meet at the border of the surface: their edge may have one
    triangle.
    """
    bad = np.bincount(faces.ravel(), minlength=count) == 0
    table = edge_table(faces, count)
    key, times = np.unique(table.start * count + table.end, return_counts=True)
    back = key % count * count + key // count
    open_key = np.concatenate([rim[:, 0] * count + rim[:, 1], rim[:, 1] * count + rim[:, 0]])
    wrong = key[(times > 1) | ~(np.isin(back, key) | np.isin(key, open_key))]
    bad[wrong // count] = bad[wrong % count] = True
    # a triangle and its reverse: where a corner has others too, an edge or the fan is wrong there
    suspect = faces[(np.bincount(faces.ravel(), minlength=count)[faces] == 2).any(axis=1)]
    _, which, times = np.unique(
        np.sort(suspect, axis=1), axis=0, return_inverse=True, return_counts=True
    )
    bad[suspect[times[which.ravel()] > 1]] = True
    return np.asarray(bad | (fan_count(faces, table, count) > 1))
