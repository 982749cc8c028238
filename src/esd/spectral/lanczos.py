"""A block Krylov space of (L − σM)⁻¹M that is extended until its eigenpairs have converged."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, TypeAlias

import numpy as np

from esd.common import FloatArray
from esd.spectral.factorisation import Factorisation
from esd.spectral.pencil import Mass, weighted

Run: TypeAlias = Callable[[Callable[[slice], Any], list[slice]], Iterator[Any]]
"""`map`, or the `map` of a pool of threads."""

_LOST = 1e-14  # a direction shorter than this share of its image is rounding error
_SLAB = 8192  # most vertices in a slab
_LARGE = 4_000_000  # multiplications


@dataclass(frozen=True, slots=True, eq=False)
class Ritz:
    """Approximate eigenpairs from a Krylov space, by ascending eigenvalue.

    Parameters
    ----------
    values : (m,)
        Approximate eigenvalues λ = σ + 1/θ.
    errors : (m,)
        Estimates of their errors, the norms of (L − σM)⁻¹Mφ − θφ divided by θ².
    coefficients : (m, m)
        Column i holds the coefficients of eigenvector i in the basis.
    """

    values: FloatArray
    errors: FloatArray
    coefficients: FloatArray


class BlockLanczos:
    """An M-orthonormal basis of a block Krylov space of B = (L − σM)⁻¹M, and B's projection.

    Vectors are rows, so that the products with the basis run at the full speed of matrix
    multiplication (at 8 vectors a block about twice as fast as with columns). Sums over vertices
    are formed in fixed slabs: the result does not depend on the number of threads.

    Parameters
    ----------
    operator
        The factorised L − σM.
    mass
        Lumped mass (n,) or consistent mass (n, n).
    block
        Vectors in the first block.
    generator
        Source of the first block.
    run
        `map` over slabs, possibly in threads.

    References
    ----------
    Grimes, Lewis, Simon: A shifted block Lanczos algorithm for solving sparse symmetric
    generalized eigenproblems, SIAM J. Matrix Anal. Appl. 15 (1994).
    """

    def __init__(
        self,
        operator: Factorisation,
        mass: Mass,
        *,
        block: int,
        generator: np.random.Generator,
        run: Run,
    ) -> None:
        n = mass.shape[0]
        self.size = 0
        self._operator, self._mass, self._generator, self._run = operator, mass, generator, run
        count = max(4, -(-n // _SLAB))
        bounds = np.linspace(0, n, count + 1).astype(int)
        self._slabs = [slice(a, b) for a, b in pairwise(bounds)]
        self._basis: FloatArray = np.empty((0, n))
        self._projection = np.empty((0, 0))
        self._last = 0  # vectors in the last block
        self._next: FloatArray = np.empty((0, n))  # the block to come, orthonormal to the basis
        self._coupling: FloatArray = np.empty((0, 0))  # B(last block) = … + coupling @ next block
        self.widen(block)

    def extend(self, size: int) -> None:
        """Add blocks until the basis has at least `size` vectors, or spans everything."""
        self._reserve(size + size // 2)  # memory that is not touched is not taken
        while self.size < min(size, self._basis.shape[1]):
            if not len(self._next):  # the basis is invariant under B: go on elsewhere
                self.widen(max(1, self._last))
            self._add_block()

    def widen(self, count: int) -> None:
        """Let random directions join the next block.

        A block of b vectors sees at most b copies of a repeated eigenvalue.
        """
        count = min(count, self._basis.shape[1] - self.size - len(self._next))
        fresh: FloatArray = self._generator.standard_normal((count, self._basis.shape[1]))
        for _ in range(2):
            for others in (self._basis[: self.size], self._next):
                self._remove(fresh, others)
        fresh, _ = self._orthonormal(fresh)
        self._next = np.concatenate([self._next, fresh])
        none = np.zeros((self._last, len(fresh)))
        self._coupling = np.concatenate([self._coupling, none], axis=1)

    def ritz(self) -> Ritz:
        """The eigenpairs of the projection."""
        theta, coefficients = np.linalg.eigh(self._projection[: self.size, : self.size])
        beyond = coefficients[self.size - self._last : self.size].T @ self._coupling
        theta[theta == 0] = np.finfo(float).tiny
        with np.errstate(over="ignore"):
            values = self._operator.shift + 1 / theta
            errors = np.linalg.norm(beyond, axis=1) / theta**2
        order = np.argsort(values, kind="stable")
        return Ritz(values[order], errors[order], coefficients[:, order])

    def vectors(self, ritz: Ritz, count: int) -> FloatArray:
        """Rows (count, n): the first eigenvectors φ, each improved to Bφ / θ.

        Bφ differs from θφ by a combination of the next block, so the step needs no solution. It
        damps what the space has left of high frequencies, and makes the norm in M⁻¹ of the
        residual Lφ − λMφ equal to the error estimated in `Ritz`.
        """
        inside = ritz.coefficients[:, :count].T
        theta = 1 / (ritz.values[:count, None] - self._operator.shift)
        beyond = inside[:, self.size - self._last :] @ self._coupling / theta
        inside = np.ascontiguousarray(inside)
        result = np.empty((count, self._basis.shape[1]))

        def combine(slab: slice) -> None:
            np.matmul(inside, self._basis[: self.size, slab], out=result[:, slab])
            result[:, slab] += beyond @ self._next[:, slab]

        list(self._run(combine, self._slabs))
        return result

    def _add_block(self) -> None:
        before, middle = self.size - self._last, self.size
        after = middle + len(self._next)
        self._reserve(after)
        self._basis[middle:after] = self._next
        self._projection[before:middle, middle:after] = self._coupling
        self._projection[middle:after, before:middle] = self._coupling.T

        block = self._basis[middle:after]
        image = np.ascontiguousarray(self._operator.solve(weighted(self._mass, block).T).T)
        lost = _LOST * self._longest(image)
        # In exact arithmetic the image has no component beyond the last two blocks; in rounded
        # arithmetic those that there are would grow, and repeat eigenvalues already found.
        diagonal = self._remove(image, self._basis[before:after])[:, middle - before :]
        self._projection[middle:after, middle:after] = (diagonal + diagonal.T) / 2
        cancelled = 1e-4 * self._longest(image)
        self._remove(image, self._basis[:after])
        self.size, self._last = after, after - middle
        rows, coupling = self._orthonormal(image, lost=lost, cancelled=cancelled)
        room = min(len(rows), self._basis.shape[1] - self.size)
        self._next, self._coupling = rows[:room], coupling[:, :room]

    def _orthonormal(
        self, rows: FloatArray, *, lost: float = 0.0, cancelled: float = 0.0
    ) -> tuple[FloatArray, FloatArray]:
        """Orthonormal Q, longest direction first, and coefficients C with rows = C Q.

        Directions shorter than `lost` are left out. If one is shorter than `cancelled`, what it
        has in common with the basis, a rounding error before, is removed again.
        """
        coefficients: FloatArray = np.eye(len(rows))
        while len(rows):
            square, axes = np.linalg.eigh(self._inner(rows, rows))
            kept = np.flatnonzero(square > max(lost**2, 1e-30 * square[-1]))[::-1]
            length, axes = np.sqrt(square[kept]), axes[:, kept]
            rows = (axes / length).T @ rows
            coefficients = coefficients @ (axes * length)
            if len(length) and length[-1] < max(cancelled, 1e-4 * length[0]):
                self._remove(rows, self._basis[: self.size])
            elif len(length) and length[-1] > 0.5 * length[0]:
                break
            lost, cancelled = 1e-8, 1e-4  # the rows have unit length now
        return rows, coefficients

    def _longest(self, rows: FloatArray) -> float:
        return float(np.sqrt(np.einsum("ij,ij->i", rows, weighted(self._mass, rows)).max()))

    def _inner(self, rows: FloatArray, others: FloatArray) -> FloatArray:
        """Inner products (b, j) in the mass of rows (b, n) and others (j, n)."""
        heavy = weighted(self._mass, rows)
        products = self._map(rows, others)(
            lambda slab: heavy[:, slab] @ others[:, slab].T, self._slabs
        )
        return np.asarray(sum(products))

    def _remove(self, rows: FloatArray, others: FloatArray) -> FloatArray:
        """Make rows orthogonal to others, in place; return the coefficients."""
        coefficients = self._inner(rows, others)

        def subtract(slab: slice) -> None:
            rows[:, slab] -= coefficients @ others[:, slab]

        list(self._map(rows, others)(subtract, self._slabs))
        return coefficients

    def _map(self, rows: FloatArray, others: FloatArray) -> Run:
        """Threads for large products; small ones take less time than handing them out."""
        return self._run if rows.size * len(others) > _LARGE else map

    def _reserve(self, size: int) -> None:
        if size <= len(self._basis):
            return
        basis = np.empty((size, self._basis.shape[1]))
        basis[: self.size] = self._basis[: self.size]
        projection = np.zeros((size, size))
        projection[: self.size, : self.size] = self._projection[: self.size, : self.size]
        self._basis, self._projection = basis, projection
