"""How far a map is from the truth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from esd.common import FloatArray, InputError, IntArray
from esd.datasets.collection import Shape
from esd.mesh.geodesics import EdgeGraph, geodesic_diameter, geodesic_graph
from esd.mesh.geometry import surface_area
from esd.mesh.mesh import Mesh

NEAR = 0.05  # of the geodesic diameter of the target: a match within it is right

_CHUNK = 256


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """Where the points of the template lie on a shape, by which maps to it are measured.

    Parameters
    ----------
    mesh
        The surface on which distances are measured.
    index : (p,)
        Its vertex at each point; -1 where it has none.
    symmetric : (p,)
        The same under left-right symmetry, or None where that is not known.
    """

    mesh: Mesh
    index: IntArray
    symmetric: IntArray | None = None


def truth_of(shape: Shape) -> Truth:
    """Where the points of the template lie on a shape of a collection, as it is in its file."""
    symmetric = None if shape.symmetric is None else shape.symmetric()
    return Truth(shape.mesh(), shape.correspondence(), symmetric)


@dataclass(frozen=True, slots=True, eq=False)
class TargetErrors:
    """Errors of several maps to one target, in units of length.

    Parameters
    ----------
    direct, nearer : (k, p)
        Geodesic distance to the true vertex, and to the nearer of the true and the mirrored one,
        for each map and point; NaN where the map has no match or the target lacks the point.
    diameter
        Geodesic diameter of the target.
    """

    direct: FloatArray
    nearer: FloatArray
    diameter: float


def errors_on_target(
    truth: Truth, predicted: IntArray, *, limit: float | None = None
) -> TargetErrors:
    """Errors of maps at the points of the template; all at once, which saves most of the time.

    Parameters
    ----------
    predicted : (k, p)
        The target vertex that each map gives each point; -1 for none.
    limit
        As a share of the geodesic diameter: larger errors are infinite. Without a limit, an error
        across components counts as the diameter.
    """
    graph = geodesic_graph(truth.mesh)
    diameter = geodesic_diameter(truth.mesh, graph=graph)
    truths = [truth.index] if truth.symmetric is None else [truth.index, truth.symmetric]
    found = geodesic_errors(
        graph,
        predicted.ravel(),
        tuple(np.tile(index, len(predicted)) for index in truths),
        limit=np.inf if limit is None else limit * diameter,
    )
    if limit is None:
        found = tuple(np.minimum(error, diameter) for error in found)
    direct, nearer = found[0], np.fmin.reduce(found)
    return TargetErrors(direct.reshape(predicted.shape), nearer.reshape(predicted.shape), diameter)


def geodesic_errors(
    graph: EdgeGraph,
    predicted: IntArray,
    truths: tuple[IntArray, ...],
    *,
    limit: float = np.inf,
) -> tuple[FloatArray, ...]:
    """Geodesic distances from predicted to true vertices of one mesh, (p,) for each of the truths.

    Distances are taken only from those vertices that occur, from the smaller of the two sides.

    Parameters
    ----------
    graph
        Of the mesh, see `geodesic_graph`.
    predicted : (p,)
        Vertices from 0; -1 for none, where the result is NaN.
    truths : (p,) each
        True vertices from 0, such as the direct and the mirrored ones; -1 where unknown: NaN.
    limit
        Longer distances may come out as infinite, which saves most of the time.
    """
    known = [(predicted >= 0) & (truth >= 0) for truth in truths]
    near = np.concatenate([predicted[k] for k in known])
    far = np.concatenate([truth[k] for truth, k in zip(truths, known, strict=True)])
    if len(np.unique(far)) < len(np.unique(near)):
        near, far = far, near
    distance = np.empty(len(near))
    # sorted by source; those of sources[i] are order[bounds[i]:bounds[i + 1]]
    order = np.argsort(near, kind="stable")
    sources, first = np.unique(near[order], return_index=True)
    bounds = np.append(first, len(order))
    for start in range(0, len(sources), _CHUNK):
        chunk = sources[start : start + _CHUNK]
        rows = graph.distances(chunk, limit=limit)
        chosen = order[bounds[start] : bounds[min(start + _CHUNK, len(sources))]]
        distance[chosen] = rows[np.searchsorted(chunk, near[chosen]), far[chosen]]
    errors = []
    for k in known:
        error = np.full(len(predicted), np.nan)
        error[k], distance = distance[: k.sum()], distance[k.sum() :]
        errors.append(error)
    return tuple(errors)


def vertex_errors(target: Mesh, predicted: IntArray, truth: IntArray) -> FloatArray:
    """Geodesic distances on a mesh from predicted to true vertices over √area, (p,).

    NaN where either is -1, infinite across components.
    """
    (errors,) = geodesic_errors(geodesic_graph(target), predicted, (truth,))
    return errors / np.sqrt(surface_area(target))


def true_map(source_points: IntArray, target_points: IntArray, source_count: int) -> IntArray:
    """The true target vertex of each source vertex, (n,), -1 where none is known.

    Parameters
    ----------
    source_points, target_points : (p,)
        The vertices of both shapes at the same points, from 0; -1 for none. Where several points
        share a source vertex, the last counts.

    Raises
    ------
    InputError
        If the two are not equally long, or a point lies beyond the source's vertices.
    """
    if len(source_points) != len(target_points):
        raise InputError(
            f"The shapes must have the same points; one has {len(source_points)}, "
            f"the other {len(target_points)}."
        )
    if source_points.max() >= source_count:
        raise InputError(
            f"The points name source vertex {source_points.max()} (from 0); "
            f"the mesh has {source_count}."
        )
    truth = np.full(source_count, -1, dtype=np.int64)
    known = source_points >= 0
    truth[source_points[known]] = target_points[known]
    return truth


def cumulative_curve(errors: FloatArray, radii: FloatArray) -> FloatArray:
    """Share of the errors that are at most each radius, (r,); NaN counts as larger than any.

    The curve of the Princeton protocol (Kim, Lipman, Funkhouser 2011).
    """
    ordered = np.sort(errors[~np.isnan(errors)])
    return np.searchsorted(ordered, radii, side="right") / max(len(errors), 1)


def area_under_curve(errors: FloatArray, *, largest: float = 0.25) -> float:
    """Mean of the cumulative curve over radii from 0 to `largest`, between 0 and 1."""
    matched = errors[~np.isnan(errors)]
    return float(np.maximum(1 - matched / largest, 0).sum() / max(len(errors), 1))
