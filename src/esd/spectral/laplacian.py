"""The discrete Laplace-Beltrami operator: stiffness and mass of linear finite elements."""

from __future__ import annotations

from typing import Any, Literal, TypeAlias, get_args

import numpy as np
from scipy import sparse

from esd.common import FloatArray, InputError
from esd.mesh.geometry import edge_lengths, is_referenced, vertex_areas
from esd.mesh.mesh import Mesh, PointCloud

SparseMatrix: TypeAlias = Any
"""A `scipy.sparse` array in compressed columns."""

LaplacianKind: TypeAlias = Literal["cotangent", "robust"]

_FEWEST_POINTS = 5
_NEIGHBOURS = 30  # of a point, among which its piece of surface is triangulated
_AREA_FLOOR = 1e-10  # of the mean area of a vertex, below which it has no mass to speak of
_FLATTEST = 1e-4  # `esd.mesh.topology.quality` below which a face counts as if it had it


def laplacian(
    shape: Mesh | PointCloud, *, kind: LaplacianKind = "cotangent"
) -> tuple[SparseMatrix, FloatArray]:
    """Stiffness (n, n) and lumped mass (n,) of the Laplace-Beltrami operator.

    The stiffness L is symmetric, positive semidefinite where the triangulation is Delaunay or the
    boundary absent, free of units, and its rows sum to zero; the mass holds squared units of
    length and sums to the surface area. Δf ≈ −M⁻¹ L f.

    Parameters
    ----------
    shape
        Vertices without a face have zero rows and zero mass. Around each point of a cloud a piece
        of surface is triangulated, and the result is always the robust one.
    kind
        `cotangent`: linear finite elements on the mesh as it is (Pinkall & Polthier 1993).
        `robust`: on an intrinsic Delaunay retriangulation of the tufted cover, for meshes with
        slivers or non-manifold edges (Sharp & Crane 2020), by the package robust-laplacian. The
        two differ on clean meshes as well.

    Raises
    ------
    InputError
        If there is no such kind, or the robust Laplacian cannot be built, as where points are too
        few or all on a line.
    """
    if kind not in get_args(LaplacianKind):
        known = "' or '".join(get_args(LaplacianKind))
        raise InputError(f"`kind` of a Laplacian must be '{known}'; got {kind!r}.")
    if isinstance(shape, PointCloud) or kind == "robust":
        return _robust(shape)
    return stiffness(shape), lumped_mass(shape)


def stiffness(mesh: Mesh) -> SparseMatrix:
    """Cotangent stiffness matrix (n, n) from the edge lengths alone.

    Entry (i, j) is −(cot α + cot β) / 2 for the angles opposite to edge ij.
    """
    cotangent = cotangents(mesh)
    rows = mesh.faces[:, [1, 2, 0]].ravel()
    columns = mesh.faces[:, [2, 0, 1]].ravel()
    size = len(mesh.vertices)
    half = sparse.coo_array((-cotangent.ravel() / 2, (rows, columns)), shape=(size, size)).tocsc()
    off_diagonal = half + half.T
    return (off_diagonal - sparse.diags_array(off_diagonal.sum(axis=0))).tocsc()


def cotangents(mesh: Mesh) -> FloatArray:
    """Cotangents of the angles at the corners of the faces, (m, 3), from the edge lengths alone.

    Those of a face that is nearly a line are made smaller, all by one factor: otherwise they would
    outweigh all others, and the stiffness be mostly rounding errors.
    """
    squared = edge_lengths(mesh) ** 2
    total = squared.sum(axis=1, keepdims=True)
    area = np.maximum(_heron(np.sqrt(squared))[:, None], _FLATTEST / (4 * 3**0.5) * total)
    # (sum of the squared sides at the corner − square of the side opposite to it) / (4 · area)
    return np.asarray((total - 2 * squared) / (4 * np.maximum(area, np.finfo(float).tiny)))


def lumped_mass(mesh: Mesh) -> FloatArray:
    """A third of the area of the faces at each vertex, (n,), in squared units of length.

    Positive for every vertex that has a face, even if all its faces are degenerate.
    """
    area = vertex_areas(mesh)
    floor = _AREA_FLOOR * float(area.mean())
    return np.where(is_referenced(mesh), np.maximum(area, floor), 0.0)


def _heron(lengths: FloatArray) -> FloatArray:
    """Areas of triangles from their sides (m, 3), in Kahan's order, exact for slivers."""
    c, b, a = np.sort(lengths, axis=1).T
    product = (a + (b + c)) * (c - (a - b)) * (c + (a - b)) * (a + (b - c))
    return np.asarray(np.sqrt(np.maximum(product, 0)) / 4)


def _robust(shape: Mesh | PointCloud) -> tuple[SparseMatrix, FloatArray]:
    import robust_laplacian

    if len(shape.vertices) < _FEWEST_POINTS:  # the package may read past the end of fewer
        raise InputError(
            f"The robust Laplacian cannot be built: {len(shape.vertices)} points are too few."
        )
    try:
        if isinstance(shape, Mesh):
            found = robust_laplacian.mesh_laplacian(shape.vertices, shape.faces)
        else:
            neighbours = min(_NEIGHBOURS, len(shape.vertices) - 1)
            found = robust_laplacian.point_cloud_laplacian(shape.vertices, n_neighbors=neighbours)
    except (RuntimeError, ValueError) as error:
        raise InputError(f"The robust Laplacian cannot be built: {error}.") from error
    matrix, mass = found
    return sparse.csc_array(matrix), np.asarray(mass.diagonal())
