"""The energy of as-rigid-as-possible deformations of a template, and its minimisation."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import sparse
from scipy.sparse.linalg import splu
from scipy.spatial import KDTree

from esd.common import BoolArray, FloatArray, IntArray
from esd.mesh.geometry import adjacency, components, vertex_areas
from esd.mesh.mesh import Mesh
from esd.mesh.topology import EdgeTable, edge_table
from esd.spectral.laplacian import cotangents

_STEPS = 4  # local and global steps, after which a round ends
_SMOOTH = 0.05  # in √area: over this length the images are smoothed of which rotations are taken
_SPREAD = 0.1  # in √area: over this length rotations are averaged
_LEAST_STIFFNESS = 0.05  # of an edge, half the sum of two cotangents where that is less
_STEEPEST = 10.0  # cotangent that counts, which those of slivers exceed
_HELD = 1e-6  # share of the weight that holds vertices where they are, so that none floats


@dataclass(frozen=True, slots=True, eq=False)
class Pull:
    """What draws the vertices: to positions, and along directions.

    The energy of vertex i is `weight[i]` |v − p|² + `along[i]` (d · v − h)², with p its position, d
    its direction and h its height.

    Parameters
    ----------
    position : (n, 3)
    weight : (n,)
    direction : (n, 3)
    height : (n,)
    along : (n,)
    """

    position: npt.NDArray[np.float64]
    weight: npt.NDArray[np.float64]
    direction: FloatArray | None = None
    height: npt.NDArray[np.float64] | None = None
    along: npt.NDArray[np.float64] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Elastic:
    """A template that resists all but rigid motions of the neighbourhood of each vertex.

    Parameters
    ----------
    rest : (n, 3)
        Vertices at rest.
    unit : float
        √area at rest, the unit of lengths.
    mass : (n,)
        Share of the area that belongs to each vertex.
    edge : (e, 2)
        Edges of the faces, and links between pieces that do not hang together.
    stiffness : (e,)
        Half the sum of the cotangents opposite to each edge.
    laplacian : (n, n)
        Of the edges with these weights.
    gather : (n, 2 e)
        Sums values of directed edges at the vertex from which they run: first the edges as they
        are, then reversed.
    """

    rest: npt.NDArray[np.float64]
    unit: float
    mass: npt.NDArray[np.float64]
    edge: IntArray
    stiffness: npt.NDArray[np.float64]
    laplacian: sparse.csr_array
    gather: sparse.csr_array

    def deformed(
        self, vertices: npt.NDArray[np.float64], pull: Pull, length: float
    ) -> npt.NDArray[np.float64]:
        """Vertices, (n, 3), that minimise pull and stiffness, from some to start with.

        Parameters
        ----------
        length
            In units of √area: the deformation is rigid at shorter distances, and follows the pull
            at longer ones.
        """
        count = len(vertices)
        held = _HELD / count
        weight = self.mass * pull.weight
        right = weight[:, None] * pull.position + held * vertices
        stiff = length**2 * self.laplacian
        solve: Callable[[npt.NDArray[np.float64]], npt.NDArray[np.float64]]
        if pull.along is None or pull.direction is None or pull.height is None:
            solve = _solver(stiff + sparse.diags_array(weight + held))
        else:
            along = self.mass * pull.along
            right = right + (along * pull.height)[:, None] * pull.direction
            blocks = along[:, None, None] * pull.direction[:, :, None] * pull.direction[:, None, :]
            blocks[:, np.arange(3), np.arange(3)] += (weight + held)[:, None]
            # coordinate c of vertex i is unknown 3 i + c
            pulls = sparse.bsr_array(
                (blocks, np.arange(count), np.arange(count + 1)), shape=(3 * count, 3 * count)
            )
            flat = _solver(sparse.kron(stiff, sparse.eye_array(3)) + pulls)

            def solve(columns: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
                return np.asarray(flat(columns.ravel()).reshape(-1, 3))

        for _ in range(_STEPS):
            rotations = nearest_rotations(self._moments(vertices))
            vertices = solve(right + length**2 * self._divergence(rotations))
        return vertices

    def interpolated(
        self, image: npt.NDArray[np.float64], weight: npt.NDArray[np.float64]
    ) -> npt.NDArray[np.float64]:
        """Positions, (n, 3), by images of some vertices, as rigid as their neighbourhood elsewhere.

        Parameters
        ----------
        image : (n, 3)
        weight : (n,)
            Of the images; zero for none.
        """
        weight = self.mass * weight
        solve = _solver(
            _SMOOTH**2 * self.laplacian + sparse.diags_array(weight + _HELD**2 / len(weight))
        )
        smooth = self.rest + solve(weight[:, None] * (image - self.rest))
        moments = self._moments(smooth, weight / np.maximum(self.mass, np.finfo(float).tiny))
        right = _SMOOTH**2 * self._divergence(self._spread(moments)) + weight[:, None] * image
        return np.asarray(solve(right))

    def energy(self, vertices: npt.NDArray[np.float64]) -> float:
        """Of a deformation, (n, 3), over the area at rest: zero for rigid motions.

        Squared deviations of edges from those at rest, rotated as around their ends, weighted by
        stiffness; see Sorkine and Alexa 2007, equation 3.
        """
        rotations = nearest_rotations(self._moments(vertices))
        i, j = self.edge.T
        mean = (rotations[i] + rotations[j]) / 2
        turned = np.einsum("eij,ej->ei", mean, self.rest[i] - self.rest[j])
        deviation = turned - (vertices[i] - vertices[j])
        return float(self.stiffness @ (deviation**2).sum(axis=1)) / self.unit**2

    def filled(
        self, vertices: npt.NDArray[np.float64], is_free: BoolArray
    ) -> npt.NDArray[np.float64]:
        """The vertices with the free ones, (n,), placed anew: between the others, as at rest."""
        inner, fixed = np.flatnonzero(is_free), np.flatnonzero(~is_free)
        rows = self.laplacian[inner]
        rotations = self._spread(self._moments(vertices, (~is_free).astype(float)))
        right = self._divergence(rotations)[inner] - rows[:, fixed] @ vertices[fixed]
        result = vertices.copy()
        held = sparse.eye_array(len(inner)) * _HELD
        result[inner] = _solver(rows[:, inner] + held)(right + _HELD * vertices[inner])
        return result

    def flattened(
        self, vertices: npt.NDArray[np.float64], is_free: BoolArray
    ) -> npt.NDArray[np.float64]:
        """The vertices with each of the free ones, (n,), at the mean of its neighbours.

        In a plane, no face between them is inverted if those that are fixed around them form a
        convex polygon (Tutte 1963, *How to draw a graph*).
        """
        inner, fixed = np.flatnonzero(is_free), np.flatnonzero(~is_free)
        joined = sparse.csr_array(adjacency(self.edge, len(vertices)).astype(float))
        rows = sparse.csr_array(sparse.diags_array(joined.sum(axis=1)) - joined)[inner]
        held = sparse.eye_array(len(inner)) * _HELD
        result = vertices.copy()
        right = _HELD * vertices[inner] - rows[:, fixed] @ vertices[fixed]
        result[inner] = _solver(rows[:, inner] + held)(right)
        return result

    def _moments(
        self, vertices: npt.NDArray[np.float64], weight: npt.NDArray[np.float64] | None = None
    ) -> npt.NDArray[np.float64]:
        """Sums over the edges of each vertex of their vector now times that at rest, (n, 3, 3).

        Parameters
        ----------
        weight : (n,), optional
            Of the vertices; an edge has the lesser of its ends.
        """
        i, j = self.edge.T
        stiffness = self.stiffness
        if weight is not None:
            stiffness = stiffness * np.minimum(weight[i], weight[j])
        before, after = self.rest[j] - self.rest[i], vertices[j] - vertices[i]
        # the same in both directions of an edge, since both vectors change sign
        moment = (stiffness[:, None, None] * after[:, :, None] * before[:, None, :]).reshape(-1, 9)
        return np.asarray((self.gather @ np.concatenate([moment, moment])).reshape(-1, 3, 3))

    def _spread(self, moments: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Rotations, (n, 3, 3), of moments averaged over the surface: the nearest decide."""
        solve = _solver(_SPREAD**2 * self.laplacian + sparse.diags_array(self.mass))
        return nearest_rotations(solve(moments.reshape(-1, 9)).reshape(-1, 3, 3))

    def _divergence(self, rotations: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Sums over the edges of each vertex of their vector at rest, rotated, (n, 3).

        The right side of Sorkine and Alexa 2007, equation 8.
        """
        i, j = self.edge.T
        mean = (rotations[i] + rotations[j]) / 2
        flow = np.einsum("eij,ej->ei", mean, self.rest[i] - self.rest[j])
        flow *= self.stiffness[:, None]
        return np.asarray(self.gather @ np.concatenate([flow, -flow]))


def elastic(rest: Mesh) -> Elastic:
    """The `Elastic` of a mesh at rest, all of whose vertices have a face.

    References
    ----------
    Sorkine, Alexa 2007, *As-rigid-as-possible surface modeling*.
    """
    vertices, count = rest.vertices, len(rest.vertices)
    table = edge_table(rest.faces, count)
    link = _links(rest)
    edge = np.concatenate([table.ends, link])
    stiffness = np.append(_edge_stiffness(rest, table), np.full(len(link), _LEAST_STIFFNESS))
    start, end = edge.T.reshape(2, -1), edge[:, ::-1].T.reshape(2, -1)
    start, end = np.concatenate([start[0], start[1]]), np.concatenate([end[0], end[1]])
    weights = sparse.csr_array((np.tile(stiffness, 2), (start, end)), shape=(count, count))
    laplacian = sparse.csr_array(sparse.diags_array(weights.sum(axis=1)) - weights)
    gather = sparse.csr_array(
        (np.ones(len(start)), (start, np.arange(len(start)))), shape=(count, len(start))
    )
    area = vertex_areas(rest)
    unit = float(np.sqrt(area.sum()))
    return Elastic(vertices, unit, area / area.sum(), edge, stiffness, laplacian, gather)


def nearest_rotations(matrices: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """The rotation nearest to each matrix, (n, 3, 3)."""
    u, _, vt = np.linalg.svd(matrices)
    u[:, :, 2] *= np.sign(np.linalg.det(u @ vt))[:, None]
    return np.asarray(u @ vt)


def _edge_stiffness(mesh: Mesh, table: EdgeTable) -> npt.NDArray[np.float64]:
    """Half the sum of the cotangents opposite to each edge, at least a little, (e,)."""
    half = np.clip(cotangents(mesh), -_STEEPEST, _STEEPEST) / 2
    # the side of a corner is that opposite to it, in both
    total = np.bincount(table.of_side.ravel(), half.ravel(), len(table.ends))
    return np.maximum(total, _LEAST_STIFFNESS)


def _links(mesh: Mesh) -> IntArray:
    """Edges, (k, 2), from the vertices of each smaller piece to the nearest of the largest."""
    piece = components(mesh)
    others = np.flatnonzero(piece > 0)
    if len(others) == 0:
        return np.zeros((0, 2), dtype=np.int64)
    main = np.flatnonzero(piece == 0)
    nearest = main[KDTree(mesh.vertices[main]).query(mesh.vertices[others])[1]]
    return np.stack([others, nearest], axis=1)


def _solver(matrix: sparse.sparray) -> Callable[[npt.NDArray[np.float64]], npt.NDArray[np.float64]]:
    """Solves with a symmetric positive definite matrix, for columns (n, b)."""
    factors = splu(
        sparse.csc_array(matrix),
        permc_spec="MMD_AT_PLUS_A",
        diag_pivot_thresh=0.0,
        options={"SymmetricMode": True},
    )
    return factors.solve
