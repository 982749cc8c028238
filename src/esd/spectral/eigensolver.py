"""The smallest eigenpairs of L φ = λ M φ, with a bound on their error and proof that none misses.

Nearly all the time of the usual way, `eigsh(L, k, M, sigma=-1e-8)`, goes into the bookkeeping of
its single-vector iteration, not into factors or solutions. Here one interior shift halves the
Krylov space that the wanted eigenvalues need, and the space grows by blocks, whose bookkeeping is
matrix multiplication. See docs/eigensolver.md for the method and measurements.
"""

from __future__ import annotations

import logging
import operator
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain, pairwise
from typing import Any

import numpy as np
from scipy import linalg, sparse
from scipy.sparse import csgraph
from scipy.sparse.linalg import eigsh

from esd.common import FloatArray, InputError
from esd.parallel import blas_libraries, thread_count
from esd.spectral.bounds import error_bound
from esd.spectral.factorisation import Factorisation, UnstableError, factorise
from esd.spectral.lanczos import BlockLanczos, Ritz, Run
from esd.spectral.laplacian import SparseMatrix
from esd.spectral.pencil import Mass, checked_pencil, weighted

_log = logging.getLogger(__name__)

_SHIFT = 0.6  # share of the wanted eigenvalues below the shift; least work from 0.57 to 0.62
_AWAY = 1e-5  # least relative distance of the shift to an eigenvalue: as many digits are lost
_SEPARATED = 1e-6  # relative gap between eigenvalues within which the inertia is trusted


@dataclass(frozen=True, slots=True, eq=False)
class Eigenpairs:
    """The k smallest eigenpairs, L φ = λ M φ with Φᵀ M Φ = I.

    Parameters
    ----------
    eigenvalues : (k,)
        Ascending. Zeros come out as rounding errors of either sign.
    eigenvectors : (n, k)
        Of each, the entry of largest magnitude is positive. This is a convention, not an
        invariant: under a small change of the mesh another entry may become the largest.
    error_bound : float
        No eigenvalue is farther than this from its exact counterpart, counted with multiplicity
        (in units of the eigenvalues).
    certified : bool
        Whether an inertia count, or a dense solution, shows that no eigenvalue was left out.
    method : str
        'block Lanczos', 'dense', or the fallback 'eigsh'.
    """

    eigenvalues: FloatArray
    eigenvectors: FloatArray
    error_bound: float
    certified: bool
    method: str


def eigenpairs(
    stiffness: SparseMatrix,
    mass: Mass,
    k: int,
    *,
    tolerance: float = 1e-9,
    seed: int = 0,
    threads: int | None = None,
) -> Eigenpairs:
    """The k smallest eigenpairs of L φ = λ M φ.

    Parameters
    ----------
    stiffness : (n, n)
        L, symmetric and positive semidefinite: a cotangent, robust, point-cloud or graph
        Laplacian, of any number of components, with or without boundary.
    mass : (n,) or sparse (n, n)
        M, lumped (all positive) or consistent (symmetric and positive definite).
    k
        From 1 to n.
    tolerance
        The `error_bound` aimed at, relative to the k-th eigenvalue (where that is zero, to the
        next). Where rounding errors, as at slivers, do not let it be reached, the log says so.
    seed
        Of the random vectors the iteration starts from. Equal seeds give equal results,
        whatever the number of threads.
    threads
        How many to use; by default as many as this process may. Meanwhile the BLAS library of the
        process is held to one: its own threads wait for each other at every one of the many small
        products, and stall where another program wants a core.

    Raises
    ------
    InputError
        If the shapes do not fit, k is out of range, an entry is not finite, L is not symmetric or
        has a negative diagonal, or M is not positive.

    Notes
    -----
    The error bound is that of Kahan: with residuals R = LΦ − MΦΛ, the exact eigenvalues can be
    numbered so that none is farther from its approximation than the norm of R in M⁻¹ (Parlett,
    The Symmetric Eigenvalue Problem, theorem 11.5.1). That norm is dominated by rounding where
    triangles degenerate; there the same theorem is applied to (L − σM)⁻¹M.
    """
    stiffness, mass = checked_pencil(stiffness, mass)
    if sparse.issparse(mass):
        _check_positive_definite(mass)
    n = len(stiffness.indptr) - 1
    k = _checked_count(k, n)
    if not 0 < tolerance < 1:
        raise InputError(f"`tolerance` must lie between 0 and 1; got {tolerance}.")
    if threads is not None and threads < 1:
        raise InputError(f"`threads` must be at least 1; got {threads}.")
    components = csgraph.connected_components(stiffness, directed=False, return_labels=False)
    block = max(4 if k < 32 else 8 if k < 600 else 16, min(components, k, 32))
    with _working_threads(threads) as run:
        small = _expected_size(k, block) >= 0.75 * n
        if small:
            dense = _dense(stiffness, mass, k, tolerance)
            if dense.certified:
                return dense
        try:
            return _block_lanczos(stiffness, mass, k, tolerance, block, seed, run)
        except UnstableError as error:
            method = "a dense solution" if small else "eigsh"
            _log.warning("Fell back to %s, which is not certified: %s", method, error)
    return dense if small else _eigsh(stiffness, mass, k, seed)


def _expected_size(k: int, block: int) -> int:
    """Krylov vectors that k eigenpairs usually need; measured on meshes of people and animals."""
    return int(1.42 * k) + 17 * block


def _block_lanczos(
    stiffness: SparseMatrix,
    mass: Mass,
    k: int,
    tolerance: float,
    block: int,
    seed: int,
    run: Run,
) -> Eigenpairs:
    """Extend a Krylov space until k pairs have converged and none is missing."""
    n = len(stiffness.indptr) - 1
    inverse = _interior_shift(stiffness, mass, k)
    krylov = BlockLanczos(
        inverse, mass, block=block, generator=np.random.default_rng(seed), run=run
    )
    size = _expected_size(k, block)
    while True:
        krylov.extend(size)
        ritz = krylov.ritz()
        scale = max(float(ritz.values[k - 1]), inverse.shift)
        allowed = tolerance * scale
        cut = _cut(ritz, k, allowed, separated=_SEPARATED * scale)
        # More copies of an eigenvalue than vectors in a block are seen by none of the blocks.
        missing = min(inverse.count_below, k) - int((ritz.values < inverse.shift).sum())
        if cut and missing <= 0:
            below, cut = _counted(stiffness, mass, cut)
            missing = below - cut.count
            if missing == 0:
                break
            if missing < 0:
                raise UnstableError("Fewer eigenvalues were counted than found.")
        if krylov.size == n:
            raise UnstableError("The Krylov space spans everything and has not converged.")
        krylov.widen(min(max(missing, 0), k))
        size = krylov.size + max(2 * block, krylov.size // 16)

    values = ritz.values[: max(cut.count, k)].copy()
    rows = krylov.vectors(ritz, len(values))
    del krylov, inverse, ritz  # the basis is the largest thing in memory
    bound = error_bound(stiffness, mass, values, rows, scale=scale, tolerance=tolerance)
    # As many eigenvalues lie below the ceiling as were found there: if none of those may lie above
    # it, they are all. Any that were found above it are only known not to lie below.
    highest = float(values[cut.count - 1]) if cut.count else -np.inf
    certified = bound < np.inf and highest + bound < cut.ceiling
    if cut.count < k:
        bound = max(bound, float(values[-1]) - cut.ceiling)
    if not certified:
        _log.warning("Not certified: the error bound of %.1e spans the ceiling.", bound)
    elif bound > allowed:
        _log.info("The eigenvalues may be wrong by %.1e, more than %.1e.", bound, allowed)
    return with_signs(values[:k], rows[:k], bound, certified, "block Lanczos")


def _interior_shift(stiffness: SparseMatrix, mass: Mass, k: int) -> Factorisation:
    """L − σM with about 0.6 k eigenvalues below σ.

    The search starts from Weyl's law for surfaces, N(λ) ≈ λ · area / 4π, and keeps the best of a
    few trials: where many eigenvalues coincide there is no such σ.
    """
    wanted = max(1, round(_SHIFT * k))
    shift = 4 * np.pi * wanted / float(mass.sum())
    low, high = 0.0, np.inf
    best: Factorisation | None = None
    for _ in range(16):
        try:
            trial = factorise(stiffness, mass, shift)
            if _distance(trial, mass) < _AWAY * shift:
                raise UnstableError("The shift is too near an eigenvalue.")
        except UnstableError:
            shift *= 1.01  # an eigenvalue was hit, or nearly; step aside
            continue
        count = trial.count_below
        if best is None or abs(count - wanted) < abs(best.count_below - wanted):
            best = trial
        if abs(count - wanted) <= max(1, 0.05 * wanted):
            break
        if count < wanted:
            low = shift
        else:
            high = shift
        if high < 1.05 * low:
            break
        shift *= min(8.0, max(0.125, wanted / max(count, 0.5)))
        if not low < shift < high:
            shift = (low + high) / 2
    if best is None:
        raise UnstableError("No shift was found at which L − σM could be factorised.")
    return best


def _distance(inverse: Factorisation, mass: Mass) -> float:
    """How far σ is from the nearest eigenvalue, if that is near: three inverse iterations."""
    row = np.random.default_rng(0).standard_normal((1, mass.shape[0]))
    for _ in range(3):
        row /= np.linalg.norm(row)
        row = inverse.solve(weighted(mass, row).T).T
    before = np.linalg.norm(weighted(mass, row))
    return float(before / np.linalg.norm(weighted(mass, inverse.solve(weighted(mass, row).T).T)))


@dataclass(frozen=True, slots=True)
class _Cut:
    """A ceiling in a gap of the spectrum, with `count` of the eigenvalues found below it.

    It may be moved by `play` either way and stays in the gap.
    """

    count: int
    ceiling: float
    play: float = 0.0


def _cut(ritz: Ritz, k: int, allowed: float, *, separated: float) -> _Cut | None:
    """Where to count the eigenvalues, or None while the first k have not converged.

    In the widest of the gaps just after the k-th eigenvalue; if copies of it go on for as long as
    the eigenvalues have converged, just before the first of the copies.
    """
    values = ritz.values
    converged = ritz.errors <= 0.2 * allowed  # several of these make the final bound
    ready = len(values) if converged.all() else int(np.argmin(converged))
    if ready < k or not np.isfinite(values[k - 1]):
        return None
    if ready == len(values) == k:
        return _Cut(k, float(values[-1]) + max(abs(float(values[-1])), allowed))
    window = 2 + k // 100
    while True:
        last = min(k + window, ready, len(values) - 1)
        gaps = values[k : last + 1] - values[k - 1 : last]
        if len(gaps) and gaps.max() > separated:
            count = k + int(np.argmax(gaps))
            low, high = float(values[count - 1]), float(values[count])
            return _Cut(count, (low + high) / 2, 0.3 * (high - low))
        if last < k + window:
            break
        window *= 2
    first = int(np.searchsorted(values, values[k - 1] - 0.25 * allowed))
    return _Cut(first, float(values[first]) - 0.5 * allowed)


def _counted(stiffness: SparseMatrix, mass: Mass, cut: _Cut) -> tuple[int, _Cut]:
    """The number of eigenvalues below the ceiling, moved to where it can be counted."""
    shares = [0.0, -1.0, 1.0, -0.5, 0.5]
    while True:
        moved = replace(cut, ceiling=cut.ceiling + shares.pop(0) * cut.play)
        try:
            return factorise(stiffness, mass, moved.ceiling).count_below, moved
        except UnstableError:
            if not (shares and cut.play):
                raise


def with_signs(
    values: FloatArray, rows: FloatArray, bound: float, certified: bool, method: str
) -> Eigenpairs:
    """The result, its eigenvectors the rows (k, n) with signs by convention."""
    for row in rows:
        if row[np.argmax(np.abs(row))] < 0:
            np.negative(row, out=row)
    return Eigenpairs(values, rows.T, bound, certified, method)


def _dense(stiffness: SparseMatrix, mass: Mass, k: int, tolerance: float) -> Eigenpairs:
    """All n eigenpairs, of which the first k are returned."""
    if sparse.issparse(mass):
        values, vectors = linalg.eigh(stiffness.toarray(), mass.toarray())
    else:
        root = 1 / np.sqrt(mass)
        values, vectors = np.linalg.eigh(root[:, None] * stiffness.toarray() * root)
        vectors *= root[:, None]
    rows = np.ascontiguousarray(vectors.T[:k])
    above = values[k - 1 :]
    zero = len(values) * np.finfo(float).eps * values[-1]
    scale = float(above[above > zero].min(initial=values[-1]))
    bound = error_bound(stiffness, mass, values[:k], rows, scale=scale, tolerance=tolerance)
    return with_signs(values[:k], rows, bound, bound <= tolerance * scale, "dense")


def _eigsh(stiffness: SparseMatrix, mass: Mass, k: int, seed: int) -> Eigenpairs:
    """The fallback: standard form if the mass is lumped, a shift below zero, a larger space."""
    n = len(stiffness.indptr) - 1
    shift = -1e-3 * 4 * np.pi * k / float(mass.sum())
    options = {
        "sigma": shift,
        "ncv": min(n, max(2 * k + 1, 20) if k < 40 else k + k // 2),
        "v0": np.random.default_rng(seed).standard_normal(n),
    }
    try:
        if sparse.issparse(mass):
            values, vectors = eigsh(stiffness, k, mass, **options)
        else:
            scale = sparse.diags_array(1 / np.sqrt(mass))
            values, vectors = eigsh(sparse.csc_array(scale @ stiffness @ scale), k, **options)
            vectors = scale @ vectors
    except RuntimeError as error:  # SuperLU: 'Factor is exactly singular'; ARPACK: not converged
        raise InputError(
            "The eigenvalues cannot be computed: the matrices are singular, as those of a mesh "
            "with many degenerate faces. Repair the mesh first."
        ) from error
    order = np.argsort(values)
    rows = np.ascontiguousarray(vectors[:, order].T)
    bound = error_bound(stiffness, mass, values[order], rows, scale=-shift, tolerance=np.inf)
    return with_signs(values[order], rows, bound, False, "eigsh")


@contextmanager
def _working_threads(threads: int | None) -> Iterator[Run]:
    """`map` over this many threads, while each call of the BLAS library stays within its own."""
    blas = blas_libraries()
    threads = thread_count(blas) if threads is None else threads
    with blas.limit(limits=1):
        if threads == 1:
            yield map
            return
        with ThreadPoolExecutor(threads - 1) as pool:
            yield partial(_shared_out, pool, threads)


def _shared_out(
    pool: Executor, threads: int, function: Callable[[slice], Any], slabs: list[slice]
) -> Iterator[Any]:
    """`map` by this thread and those of a pool: to work costs less than to wait and be woken."""
    bounds = [len(slabs) * i // threads for i in range(threads + 1)]
    parts = [slabs[start:end] for start, end in pairwise(bounds)]
    others = [pool.submit(lambda part: [function(slab) for slab in part], p) for p in parts[1:]]
    own = [function(slab) for slab in parts[0]]
    return chain(own, *(other.result() for other in others))


def _checked_count(k: int, n: int) -> int:
    try:
        k = operator.index(k)
    except TypeError as error:
        raise InputError(f"`k` must be an integer; got {k!r}.") from error
    if not 1 <= k <= n:
        raise InputError(f"`k` must be from 1 to {n}, the number of vertices; got {k}.")
    return k


def _check_positive_definite(mass: SparseMatrix) -> None:
    try:
        positive = factorise(mass, mass, 0.0).count_below == 0
    except UnstableError:
        positive = False
    if not positive:
        raise InputError("`mass` must be positive definite; this matrix is not.")
