"""Missing parts of registered shapes, and estimates of them from the shapes that have them."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.sparse import csgraph

from esd.common import BoolArray, FloatArray
from esd.mesh.geometry import adjacency, edges, vertex_areas
from esd.mesh.mesh import Mesh

_ROUNDS = 100
_TOLERANCE = 1e-4  # of the root mean square variation: change of the estimates that ends the rounds
_SMALLEST = 0.01  # share of the area of a part that is missing
_EXPLAINED = 0.9  # share of the variance that the modes of the estimate explain


def is_present(vertices: FloatArray) -> BoolArray:
    """Whether each vertex, (…, 3), is there: none of its coordinates is NaN."""
    return np.asarray(np.isfinite(vertices).all(axis=-1))


def missing_parts(mesh: Mesh, supported: BoolArray) -> BoolArray:
    """Whether each vertex of a registered template lies in a part that the shape lacks, (n,).

    Parts are pieces of the surface without support that have at least a hundredth of the area:
    smaller ones, as between fingers, are where the template was carried on.

    Parameters
    ----------
    supported : (n,)
        Whether the shape has a surface at each vertex.
    """
    joined = edges(mesh)
    open_edges = joined[~supported[joined].any(axis=1)]
    _, part = csgraph.connected_components(adjacency(open_edges, len(supported)), directed=False)
    areas = vertex_areas(mesh)
    share = np.bincount(part, areas)[part] / areas.sum()
    return np.asarray(~supported & (share >= _SMALLEST))


def completed(vertices: npt.NDArray[np.float64], *, mass: FloatArray) -> npt.NDArray[np.float64]:
    """Aligned shapes, (s, n, 3), with estimates where vertices are missing; all have one shape.

    The estimates are the vertices that the principal modes of all shapes give, shrunk towards the
    mean by how much of each mode is noise. No more than half as many modes are used as there are
    shapes.

    Parameters
    ----------
    vertices : (s, n, 3)
        NaN at missing vertices.
    mass : (n,)
        Weights of the vertices; they sum to one.

    References
    ----------
    Josse, Husson 2012, *Handling missing values in exploratory multivariate data analysis methods*
    (regularised iterative PCA, algorithm 2).
    """
    present = is_present(vertices)
    if present.all():
        return vertices
    count = present.sum(axis=0)
    first = np.where(present[:, :, None], vertices, 0.0).sum(axis=0) / count[:, None]
    filled = np.where(present[:, :, None], vertices, first)
    most = max(1, len(vertices) // 2)
    for _ in range(_ROUNDS):
        mean = filled.mean(axis=0)
        centred = filled - mean
        gram = np.einsum("ivc,jvc,v->ij", centred, centred, mass, optimize=True)
        values, vectors = np.linalg.eigh(gram)
        values, vectors = np.maximum(values[::-1], 0.0), vectors[:, ::-1]
        total = values.sum()
        if total <= 0:
            break
        rank = min(most, int(np.searchsorted(np.cumsum(values), _EXPLAINED * total)) + 1)
        rest = max(len(values) - 1 - rank, 1)  # one direction has no variance: the mean is out
        noise = values[rank:].sum() / rest
        share = np.maximum(values[:rank] - noise, 0.0) / np.maximum(values[:rank], 1e-300)
        smoother = (vectors[:, :rank] * share) @ vectors[:, :rank].T
        estimate = mean + np.einsum("ij,jvc->ivc", smoother, centred, optimize=True)
        after = np.where(present[:, :, None], vertices, estimate)
        change = np.sqrt((((after - filled) ** 2).sum(axis=2) @ mass).max())
        filled = after
        if change < _TOLERANCE * np.sqrt(total / len(vertices)):
            break
    return filled
