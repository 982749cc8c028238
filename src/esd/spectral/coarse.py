"""Copies of meshes: coarser ones of dense meshes, finer ones of coarse meshes."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg

from esd.common import FloatArray, InputError, IntArray
from esd.mesh.geometry import is_referenced
from esd.mesh.mesh import Mesh, PointCloud
from esd.mesh.shapes import subdivide
from esd.mesh.surface import SurfacePoints, at_vertices, closest_points, interpolated
from esd.mesh.topology import compacted
from esd.spectral.cache import Arrays, Cache, content_key
from esd.spectral.laplacian import LaplacianKind, lumped_mass
from esd.spectral.spectrum import Spectrum, spectrum

# of copies: graded ones are uneven where the dense mesh has creases, such as decimated ones have
_STYLE = "even"


@dataclass(frozen=True, slots=True, eq=False)
class MeshCopy:
    """A mesh with other vertices on the same surface, and where the n original ones lie on it.

    Parameters
    ----------
    mesh : Mesh
        The copy.
    vertices : (n, 3)
        Of the original mesh.
    points : (n,)
        The point of the copy closest to each original vertex; none where that has no face.
    """

    mesh: Mesh
    vertices: FloatArray
    points: SurfacePoints

    def carried(self, values: FloatArray) -> FloatArray:
        """Values at the original vertices, (n, …), of values at the copy's; NaN for none."""
        return interpolated(values, self.mesh, self.points)


def coarse_copy(
    mesh: Mesh | PointCloud, vertex_count: int, *, cache: Cache | None = None
) -> MeshCopy:
    """A copy of a mesh remeshed to about some number of vertices, equal for equal meshes.

    A mesh that has no more is its own copy.

    Parameters
    ----------
    cache
        Where it is looked up and kept.

    Raises
    ------
    InputError
        If there are only points, the mesh is no oriented manifold, or the number is too small to
        follow its surface.
    """
    from esd.mesh.remesh.remesh import remesh  # slow to import: it searches in trees

    if isinstance(mesh, PointCloud):
        raise InputError("Points without faces have no coarse copy; leave them as they are.")
    used = np.flatnonzero(is_referenced(mesh))
    copy, near = mesh, np.arange(len(mesh.vertices))
    if len(used) > vertex_count:

        def compute() -> Arrays:
            made = remesh(mesh, vertex_count, style=_STYLE, seed=0)
            return {"vertices": made.mesh.vertices, "faces": made.mesh.faces, "near": made.nearest}

        key = content_key("coarse", mesh.vertices, mesh.faces, count=vertex_count, style=_STYLE)
        arrays = compute() if cache is None else cache.computed(key, compute)
        copy, near = Mesh(arrays["vertices"], arrays["faces"]), arrays["near"]
    return _located_on(copy, mesh, used, near[used])


def copy_around(mesh: Mesh, around: Mesh) -> MeshCopy:
    """A surface around the pieces of a mesh as its copy: its vertices lie at the closest points."""
    from scipy.spatial import KDTree  # slow to import

    used = np.flatnonzero(is_referenced(mesh))
    _, near = KDTree(around.vertices).query(mesh.vertices[used], workers=-1)
    return _located_on(around, mesh, used, near)


def _located_on(copy: Mesh, mesh: Mesh, used: IntArray, near: IntArray) -> MeshCopy:
    """The copy with the points closest to the vertices of a mesh that are used, (u,).

    Parameters
    ----------
    near : (u,)
        A vertex of the copy near each of them.
    """
    face = np.full(len(mesh.vertices), -1, dtype=np.int64)
    weights = np.full((len(face), 3), np.nan)
    closest = closest_points(copy, mesh.vertices[used], near)
    face[used], weights[used] = closest.face, closest.weights
    return MeshCopy(copy, mesh.vertices, SurfacePoints(face, weights))


def fine_copy(mesh: Mesh, least: int) -> MeshCopy:
    """A copy of a mesh subdivided until it has at least some number of vertices.

    The surface stays the same: flat faces are cut in four at the midpoints of their edges.
    Vertices without a face are left out.
    """
    copy = mesh
    while len(copy.vertices) < least:
        copy = subdivide(copy)
    # the first vertices of a subdivided mesh are those of the mesh
    points = at_vertices(copy, np.arange(len(mesh.vertices)))
    # without vertices that have no face, which could only be matched with each other
    return MeshCopy(compacted(copy)[0], mesh.vertices, points)


def coarse_spectrum(
    mesh: Mesh | PointCloud,
    k: int = 300,
    *,
    vertex_count: int,
    kind: LaplacianKind = "cotangent",
    cache: Cache | None = None,
) -> Spectrum:
    """About the k smallest eigenpairs of a dense mesh, for unit surface area: those of a copy.

    The eigenvalues are the copy's; its eigenvectors are interpolated, and made orthonormal in the
    mass of the dense mesh. See docs/eigensolver.md for how far they are off.

    Parameters
    ----------
    vertex_count
        Of the copy, see `coarse_copy`. A mesh that has no more gets its own spectrum.
    kind, cache
        See `esd.spectral.spectrum.spectrum`.

    Raises
    ------
    InputError
        If the mesh has no such copy, or that no such spectrum.
    """
    copy = coarse_copy(mesh, vertex_count, cache=cache)
    coarse = spectrum(copy.mesh, k, kind=kind, cache=cache)
    if copy.mesh is mesh:
        return coarse
    assert isinstance(mesh, Mesh)
    mass = lumped_mass(mesh)
    mass /= mass.sum()
    vectors = np.nan_to_num(copy.carried(coarse.eigenvectors), copy=False)
    overlap = sum(
        part.T @ (weight[:, None] * part)
        for part, weight in zip(*(np.array_split(x, 64) for x in (vectors, mass)), strict=True)
    )
    vectors = linalg.solve_triangular(linalg.cholesky(overlap, lower=True), vectors.T, lower=True).T
    return replace(coarse, eigenvectors=vectors, mass=mass)
