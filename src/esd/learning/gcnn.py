"""Geodesic patches: values around each vertex in polar coordinates (Masci et al. 2015)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

import numpy as np
import numpy.typing as npt
from scipy import sparse
from scipy.sparse import csgraph

from esd.common import FloatArray, InputError, IntArray, is_count, is_positive
from esd.mesh.geometry import edges, surface_area, vertex_normals
from esd.mesh.mesh import Mesh
from esd.spectral.laplacian import SparseMatrix

ComplexArray: TypeAlias = npt.NDArray[np.complexfloating[Any, Any]]

_CHUNK = 2**20  # vertices of all patches that are made at once, those beyond the patches included
_REACH = 1.1  # radii: where a patch ends
_DETOUR = 1.4  # how much longer than the distance a path along edges may be
_SMALLEST = 0.01  # of the largest weight of a bin; smaller ones are left out
_OPPOSITE = 1e-9  # of one and a cosine: normals that point in opposite directions


@dataclass(frozen=True, slots=True)
class GeodesicPatches:
    """How geodesic patches are divided; by default as by their authors, but for the radius.

    Parameters
    ----------
    rings, rays
        Numbers of bins along the radius and around.
    radius
        Of a patch, over the square root of the shape's area. By default a patch has about 60 of
        5,000 vertices; with the authors' 1 % of the geodesic diameter it would have one.
    """

    kind: Literal["geodesic"] = "geodesic"
    rings: int = 5
    rays: int = 16
    radius: float = 0.045

    def __post_init__(self) -> None:
        if not (is_count(self.rings) and is_count(self.rays) and is_positive(self.radius)):
            raise InputError(
                "Geodesic patches need rings and rays, one or more, and a positive radius; got "
                f"{self.rings!r}, {self.rays!r} and {self.radius!r}."
            )

    @property
    def bins(self) -> tuple[int, int]:
        """Rings and rays."""
        return self.rings, self.rays


def geodesic_patches(mesh: Mesh, patches: GeodesicPatches) -> SparseMatrix:
    """Weights (n · rings · rays, n) that average values at the vertices over bins, float32.

    The rows of a vertex are adjacent: its rings from the inside, of each ring the rays
    counter-clockwise as seen from outside, the first of which is arbitrary. Each row sums to one.
    With D and θ the polar coordinates of a vertex around another, its weight in the other's bin at
    (ρ, ϑ) is proportional to

        exp(−(D − ρ)² / 2σ²) exp(−(θ − ϑ)² / 2τ²)

    where σ and τ are half the distance between two rings and between two rays. The vertex itself
    lies on all rays. A bin in which there is no vertex takes the values of the nearest ones;
    vertices beyond 1.1 radii, and weights below 1 % of the largest in a bin, are left out. Vertices
    without a face keep their own value.

    Coordinates come from the discrete exponential map (Schmidt, Grimm, Wyvill 2006): the edges on
    the shortest path from the middle, each turned into the middle's tangent plane along the path,
    are added up. That is exact where the surface is flat.

    References
    ----------
    Masci, Boscaini, Bronstein, Vandergheynst 2015, *Geodesic convolutional neural networks on
    Riemannian manifolds*, section 4.
    """
    size = len(mesh.vertices)
    scale = patches.radius * float(np.sqrt(surface_area(mesh)))
    steps = _steps(mesh)
    blocks = []
    for middles in np.array_split(np.arange(size), -(-(size**2) // _CHUNK)):
        row, vertex, place = _logarithmic_maps(steps, middles, reach=_REACH * scale)
        blocks.append(_bin_weights(row, vertex, place / scale, patches, (len(middles), size)))
    return sparse.vstack(blocks, format="csr")


@dataclass(frozen=True, slots=True, eq=False)
class _Steps:
    """Edges of a mesh as sparse matrices (n, n), from the vertex of the row to that of the column.

    Tangent vectors are complex numbers, in a frame of each vertex.

    Parameters
    ----------
    length
        Of the edge.
    vector
        The edge as a tangent vector at the row, of equal length.
    turn
        Number of modulus one that takes vectors at the column into the frame of the row.
    """

    length: Any
    vector: Any
    turn: Any


def _steps(mesh: Mesh) -> _Steps:
    normal = vertex_normals(mesh)
    first = np.cross(normal, np.eye(3)[np.abs(normal).argmin(axis=1)])
    first /= np.maximum(np.linalg.norm(first, axis=1, keepdims=True), np.finfo(float).tiny)
    second = np.cross(normal, first)
    half = edges(mesh)
    i, j = np.concatenate([half, half[:, ::-1]]).T

    def in_frame(vectors: FloatArray) -> ComplexArray:
        """Vectors in space as unit vectors in the tangent planes of the rows."""
        values = _dot(vectors, first[i]) + 1j * _dot(vectors, second[i])
        return np.asarray(values / np.maximum(np.abs(values), np.finfo(float).tiny))

    edge = mesh.vertices[j] - mesh.vertices[i]
    length = np.maximum(np.linalg.norm(edge, axis=1), np.finfo(float).tiny)
    # the first axis at the column, by the smallest rotation that aligns both normals
    axis = np.cross(normal[j], normal[i])
    cosine = _dot(normal[i], normal[j])
    share = _dot(axis, first[j]) / np.maximum(1 + cosine, _OPPOSITE)
    carried = first[j] * cosine[:, None] + np.cross(axis, first[j]) + axis * share[:, None]
    shape = (len(mesh.vertices), len(mesh.vertices))
    values = (length, in_frame(edge) * length, in_frame(carried))
    return _Steps(*(sparse.csr_array((each, (i, j)), shape=shape) for each in values))


def _dot(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.asarray(np.einsum("ij,ij->i", a, b))


def _logarithmic_maps(
    steps: _Steps, middles: IntArray, *, reach: float
) -> tuple[IntArray, IntArray, ComplexArray]:
    """Place in `middles`, a vertex around it, and that in the middle's tangent plane, (e,) each.

    Ordered by the first two. Each middle has its neighbours, and all vertices within reach.
    """
    distance, before = csgraph.dijkstra(
        steps.length, indices=middles, limit=_DETOUR * reach, return_predecessors=True
    )
    middle, neighbour = steps.length[middles].nonzero()
    beyond = np.isinf(distance[middle, neighbour])
    before[middle[beyond], neighbour[beyond]] = middles[middle[beyond]]
    own = np.arange(len(middles)), middles
    place = np.full(before.shape, np.nan + 0j)
    turn = np.ones_like(place)
    place[own] = 0
    row, vertex = np.nonzero(before >= 0)
    while len(row):
        source = before[row, vertex]
        known = ~np.isnan(place[row, source])
        here, last, end = row[known], source[known], vertex[known]
        place[here, end] = place[here, last] + turn[here, last] * steps.vector[last, end]
        turn[here, end] = turn[here, last] * steps.turn[last, end]
        row, vertex = row[~known], vertex[~known]
    within = np.abs(place) <= reach
    within[own] = within[middle, neighbour] = True
    row, vertex = np.nonzero(within)
    return row, vertex, place[row, vertex]


def _bin_weights(
    row: IntArray,
    vertex: IntArray,
    place: ComplexArray,
    patches: GeodesicPatches,
    shape: tuple[int, int],
) -> SparseMatrix:
    """Rows of `geodesic_patches`, of shape[0] vertices out of shape[1].

    Parameters
    ----------
    row, vertex, place : (e,)
        As `_logarithmic_maps` has them, over the radius.
    """
    distance = np.abs(place)[:, None]
    ring = (np.arange(patches.rings) + 0.5) / patches.rings
    ray = 2 * np.pi * np.arange(patches.rays) / patches.rays
    turn = (np.angle(place)[:, None] - ray + np.pi) % (2 * np.pi) - np.pi
    turn[distance[:, 0] == 0] = 0
    radial = ((distance - ring) * 2 * patches.rings) ** 2 / 2
    angular = (turn * patches.rays / np.pi) ** 2 / 2
    weight = -(radial[:, :, None] + angular[:, None, :]).reshape(len(place), -1).astype(np.float32)
    first = np.searchsorted(row, np.arange(shape[0]))
    weight = np.exp(weight - np.maximum.reduceat(weight, first)[row])
    weight[weight < _SMALLEST] = 0
    weight /= np.add.reduceat(weight, first)[row]
    entry, place_in_patch = np.nonzero(weight)
    bins = weight.shape[1]
    return sparse.csr_array(
        (weight[entry, place_in_patch], (row[entry] * bins + place_in_patch, vertex[entry])),
        shape=(shape[0] * bins, shape[1]),
    )
