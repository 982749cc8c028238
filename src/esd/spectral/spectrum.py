"""The Laplace-Beltrami spectrum of a mesh."""

from __future__ import annotations

import logging
import os
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.sparse import csgraph

from esd.common import BoolArray, FloatArray, InputError, IntArray, whole_file
from esd.mesh.convert import MeshLike, as_mesh
from esd.mesh.geometry import components, is_referenced, surface_area
from esd.mesh.mesh import PointCloud
from esd.spectral.cache import Arrays, Cache, content_key
from esd.spectral.eigensolver import eigenpairs
from esd.spectral.laplacian import LaplacianKind, SparseMatrix, laplacian

_log = logging.getLogger(__name__)

_ROUNDING = 1e-12  # relative difference of areas that are the same

_ZERO = 1e-9  # eigenvalue, for unit area, below which it is zero but for rounding

_SOLVER_VERSION = 3  # part of the cache's keys; raised when the eigenpairs may change


@dataclass(frozen=True, slots=True, eq=False)
class Spectrum:
    """Smallest eigenpairs of the Laplace-Beltrami operator, L φ = λ M φ with Φᵀ M Φ = I.

    Parameters
    ----------
    eigenvalues : (k,)
        Ascending, in units of 1 / area; the first `zero_modes` are exactly zero.
    eigenvectors : (n, k)
        In units of 1 / √area. Zero at vertices without a face. Their signs, and bases within
        repeated eigenvalues, are arbitrary.
    mass : (n,)
        Lumped mass: the area that belongs to each vertex. Zero at vertices without a face.
    zero_modes : int
        Number of connected components, and so of constant eigenvectors.
    """

    eigenvalues: FloatArray
    eigenvectors: FloatArray
    mass: FloatArray
    zero_modes: int

    def __repr__(self) -> str:
        n, k = self.eigenvectors.shape
        return f"<Spectrum of {k} eigenpairs at {n} vertices>"

    @property
    def area(self) -> float:
        """Area of the surface: the sum of the mass; one unless it was rescaled."""
        return float(self.mass.sum())

    def with_area(self, area: float) -> Spectrum:
        """The spectrum of the shape scaled to an area: λ ∝ 1 / area, φ ∝ 1 / √area, M ∝ area."""
        factor = area / self.area
        if abs(factor - 1) < _ROUNDING:
            return self
        return replace(
            self,
            eigenvalues=self.eigenvalues / factor,
            eigenvectors=self.eigenvectors / np.sqrt(factor),
            mass=self.mass * factor,
        )

    def carried(self, vertex_index: IntArray) -> Spectrum:
        """The spectrum at the vertices of a mesh that was repaired before it was computed.

        Vertices that were joined share their mass evenly, so Φᵀ M Φ = I still holds where no
        vertex of the repaired mesh was added.

        Parameters
        ----------
        vertex_index : (n,)
            The vertex here of each of the others; -1 for none, which has neither mass nor value.
        """
        kept = vertex_index >= 0
        share = np.bincount(vertex_index[kept], minlength=len(self.mass))[vertex_index]
        return replace(
            self,
            eigenvectors=np.where(kept[:, None], self.eigenvectors[vertex_index], 0.0),
            mass=np.where(kept, self.mass[vertex_index] / np.maximum(share, 1), 0.0),
        )

    def truncated(self, k: int) -> Spectrum:
        """The first k eigenpairs.

        Raises
        ------
        InputError
            If there are fewer.
        """
        if not self.zero_modes < k <= len(self.eigenvalues):
            raise InputError(
                f"`k` must be from {self.zero_modes + 1} to {len(self.eigenvalues)}, "
                f"the pairs at hand; got {k}."
            )
        return replace(
            self, eigenvalues=self.eigenvalues[:k], eigenvectors=self.eigenvectors[:, :k]
        )

    def nonzero(self) -> tuple[FloatArray, FloatArray]:
        """Eigenvalues and eigenvectors without the constant modes."""
        return self.eigenvalues[self.zero_modes :], self.eigenvectors[:, self.zero_modes :]


def spectrum(
    shape: MeshLike | PointCloud,
    k: int = 300,
    *,
    kind: LaplacianKind = "cotangent",
    cache: Cache | None = None,
) -> Spectrum:
    """The k smallest eigenpairs of a shape's Laplace-Beltrami operator, for unit surface area.

    Scaling to unit area makes all that is computed from the result independent of the units of
    the mesh; `Spectrum.with_area` undoes it.

    Parameters
    ----------
    shape
        A mesh of any number of components, with or without boundary, as `esd.match` takes them, or
        a point cloud.
    k
        Number of eigenpairs, the constant ones included.
    kind
        Which Laplacian, see `laplacian`.
    cache
        Where the result is looked up and kept.

    Raises
    ------
    InputError
        If the mesh cannot be read, has no area, no more than k vertices or too many components for
        k, or if its spectrum has more zeros than components.
    """
    if isinstance(shape, PointCloud):
        return _cloud_spectrum(shape, k, cache)
    mesh = as_mesh(shape)
    referenced = is_referenced(mesh)
    zero_modes = int(components(mesh).max()) + 1
    _check_count(k, int(referenced.sum()), zero_modes)

    def compute() -> Arrays:
        if not surface_area(mesh) > 0:
            raise InputError("The mesh has no area: all its faces are degenerate.")
        matrix, mass = laplacian(mesh, kind=kind)
        return _solved(matrix, mass, k, referenced, zero_modes)

    parameters = {"k": k, "kind": kind, "solver": _SOLVER_VERSION}
    key = content_key("spectrum", mesh.vertices, mesh.faces, **parameters)
    arrays = compute() if cache is None else cache.computed(key, compute)
    return Spectrum(**arrays, zero_modes=zero_modes)


def _cloud_spectrum(cloud: PointCloud, k: int, cache: Cache | None) -> Spectrum:
    """As `spectrum`; points are connected where the pieces of surface around them overlap."""
    _check_count(k, len(cloud.vertices), 1)

    def compute() -> Arrays:
        matrix, mass = laplacian(cloud)
        zero_modes = int(csgraph.connected_components(matrix, directed=False)[0])
        used = np.ones(len(mass), dtype=bool)
        _check_count(k, len(mass), zero_modes)
        return _solved(matrix, mass, k, used, zero_modes)

    key = content_key("points", cloud.vertices, k=k, solver=_SOLVER_VERSION)
    arrays = compute() if cache is None else cache.computed(key, compute)
    return Spectrum(**arrays, zero_modes=int((arrays["eigenvalues"] == 0).sum()))


def _check_count(k: int, size: int, zero_modes: int) -> None:
    if not zero_modes < k <= size:
        raise InputError(
            f"{k} eigenpairs were asked for; this mesh of {size} connected vertices in "
            f"{zero_modes} component(s) allows {zero_modes + 1} to {size}. "
            "Ask for another number, or refine or repair the mesh."
        )


def _solved(
    matrix: SparseMatrix, mass: FloatArray, k: int, used: BoolArray, zero_modes: int
) -> Arrays:
    area = mass.sum()
    start = time.perf_counter()
    solution = eigenpairs(matrix[used][:, used], mass[used] / area, k)
    seconds = time.perf_counter() - start
    _log.info("%d eigenpairs of %d vertices were computed in %.1f s.", k, used.sum(), seconds)
    zeros = int((solution.eigenvalues < _ZERO).sum())
    if zeros > zero_modes or not np.isfinite(solution.eigenvectors).all():
        raise InputError(
            f"The spectrum cannot be used: {zeros} of its eigenvalues are zero, while the mesh has "
            f"{zero_modes} component(s). Degenerate faces cut vertices off; repair the mesh first."
        )
    eigenvectors = np.zeros((len(mass), k))
    eigenvectors[used] = solution.eigenvectors
    eigenvalues = solution.eigenvalues.copy()
    eigenvalues[:zero_modes] = 0.0
    return {"eigenvalues": eigenvalues, "eigenvectors": eigenvectors, "mass": mass / area}


def check_spectrum_path(path: str | os.PathLike[str]) -> Path:
    """The path, if a spectrum can be written to it; raises an `InputError` otherwise."""
    path = Path(path)
    if path.suffix.lower() != ".npz":
        raise InputError(f"'{path}': spectra are written as .npz files.")
    return path


def save_spectrum(result: Spectrum, path: str | os.PathLike[str]) -> None:
    """Write eigenvalues, eigenvectors, mass and zero modes to a `.npz` file.

    Raises
    ------
    InputError
        If the suffix is another, or the file cannot be written.
    """
    path = check_spectrum_path(path)
    with whole_file(path) as temporary, temporary.open("wb") as file:
        np.savez(
            file,
            eigenvalues=result.eigenvalues,
            eigenvectors=result.eigenvectors,
            mass=result.mass,
            zero_modes=np.int64(result.zero_modes),
        )
