"""Anisotropic patches: heat kernels that are long in one direction (Boscaini et al. 2016)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy import sparse

from esd.common import FloatArray, InputError, IntArray, is_count, is_positive
from esd.mesh.geometry import (
    face_areas,
    face_normals,
    surface_area,
    unit,
    vertex_areas,
    vertex_normals,
)
from esd.mesh.mesh import Mesh
from esd.spectral.laplacian import SparseMatrix, lumped_mass

_SMOOTHINGS = 2  # of the curvature, over the faces at each vertex
_STEP = 0.25  # largest eigenvalue times the first time step
_AREA_FLOOR = 1e-10  # of the mean area of a face; below it a gradient is rounding error
_NEGLIGIBLE = 1e-3  # share of a row below which an entry of a heat operator is left out


@dataclass(frozen=True, slots=True)
class AnisotropicPatches:
    """How anisotropic patches are made; by default as by their authors.

    Parameters
    ----------
    times
        Number of times: longest / times, 2 longest / times, … up to
    longest
        as a share of the shape's area. The authors have 6 to 24 for shapes of a geodesic diameter
        of 200, which for people is 0.0004 to 0.0016 of the area.
    angles
        Number of directions, evenly spaced over half a turn.
    anisotropy
        α: along one direction heat flows 1 + α times as well as across it.
    entries
        Of each kernel, the largest that are kept.
    """

    kind: Literal["anisotropic"] = "anisotropic"
    times: int = 5
    longest: float = 1.6e-3
    angles: int = 16
    anisotropy: float = 100.0
    entries: int = 16

    def __post_init__(self) -> None:
        counts, sizes = (self.times, self.angles, self.entries), (self.longest, self.anisotropy)
        if not (all(map(is_count, counts)) and all(map(is_positive, sizes))):
            raise InputError(
                "Anisotropic patches need times, angles and entries, one or more each, and a "
                f"positive longest time and anisotropy; got {counts} and {sizes}."
            )

    @property
    def bins(self) -> tuple[int, int]:
        """Times and angles."""
        return self.times, self.angles


def anisotropic_patches(mesh: Mesh, patches: AnisotropicPatches) -> SparseMatrix:
    """Weights (n · times · angles, n) that average values at the vertices by heat kernels, float32.

    The rows of a vertex are adjacent: its times, the shortest first, of each time the angles,
    counter-clockwise as seen from outside, from the direction in which the surface is curved most.
    In that of angle θ heat flows least. Of each kernel only the largest entries are kept, and
    divided by their sum. Vertices without a face keep their own value.

    References
    ----------
    Boscaini, Masci, Rodolà, Bronstein 2016, *Learning shape correspondence with anisotropic
    convolutional neural networks*, section 4.
    """
    size = len(mesh.vertices)
    step = patches.longest / patches.times * surface_area(mesh)
    columns, weights = [], []
    for angle in np.pi * np.arange(patches.angles) / patches.angles:
        stiffness = anisotropic_stiffness(mesh, angle=angle, anisotropy=patches.anisotropy)
        first = heat_operator(stiffness, lumped_mass(mesh), step)
        operator = first
        for time in range(patches.times):
            if time:
                operator = _without_negligible(operator @ first, _NEGLIGIBLE)
            column, weight = _largest(operator, patches.entries)
            columns.append(column)
            weights.append(weight)
    # computed by angle, then time, then vertex; wanted by vertex, then time, then angle
    order = (patches.angles, patches.times, size, patches.entries)
    column, weight = (
        np.array(each).reshape(order).transpose(2, 1, 0, 3) for each in (columns, weights)
    )
    rows = size * patches.times * patches.angles
    indptr = np.arange(rows + 1) * patches.entries
    result = sparse.csr_array((weight.ravel(), column.ravel(), indptr), shape=(rows, size))
    result.eliminate_zeros()
    return result


def anisotropic_stiffness(mesh: Mesh, *, angle: float, anisotropy: float) -> SparseMatrix:
    """Stiffness (n, n) of −div D grad, by linear finite elements.

    In each face D = R diag(1 / (1 + α), 1) Rᵀ, where R turns counter-clockwise by an angle from the
    direction of largest curvature. With α = 0 it is `esd.spectral.laplacian.stiffness`.
    """
    gradient = _gradients(mesh)
    slow = _curved_most(mesh)
    across = np.cross(unit(face_normals(mesh)), slow)
    slow = np.cos(angle) * slow + np.sin(angle) * across
    along = np.einsum("fci,fi->fc", gradient, slow)
    # D is the identity but for the slow direction
    conductivity = 1 / (1 + anisotropy) - 1
    entries = np.einsum("fci,fdi->fcd", gradient, gradient)
    entries += conductivity * along[:, :, None] * along[:, None, :]
    entries *= face_areas(mesh)[:, None, None]
    i, j = np.repeat(mesh.faces, 3, axis=1), np.tile(mesh.faces, 3)
    size = len(mesh.vertices)
    return sparse.coo_array((entries.ravel(), (i.ravel(), j.ravel())), shape=(size, size)).tocsr()


def heat_operator(stiffness: SparseMatrix, mass: FloatArray, time: float) -> SparseMatrix:
    """exp(−t M⁻¹ L), (n, n), whose row x holds the heat kernel h(x, y) times the area at y.

    By the second-order Taylor polynomial for a step so short that it is accurate for all
    eigenvalues, and then squaring. Entries are left out that would not grow beyond 0.001 of a row;
    each row is divided by its sum, which is one.
    """
    inverse = np.divide(1, mass, out=np.zeros_like(mass), where=mass > 0)
    generator = sparse.diags_array(inverse) @ stiffness
    fastest = abs(generator).sum(axis=1).max()  # bounds the eigenvalues
    doublings = max(0, int(np.ceil(np.log2(fastest * time / _STEP))))
    small = generator * (-time / 2**doublings)
    one = sparse.eye_array(len(mass), format="csr")
    result = one + small + (small @ small) / 2
    for remaining in range(doublings, 0, -1):
        result = _without_negligible(result @ result, _NEGLIGIBLE / 2 ** (remaining - 1))
    return result


def _without_negligible(operator: SparseMatrix, smallest: float) -> SparseMatrix:
    operator.data[np.abs(operator.data) < smallest] = 0
    operator.eliminate_zeros()
    operator.data /= np.repeat(operator.sum(axis=1), np.diff(operator.indptr))
    return operator


def _largest(operator: SparseMatrix, count: int) -> tuple[IntArray, FloatArray]:
    """Columns and values, (n, count) each, of the largest entries of each row, made of sum one."""
    entries = np.diff(operator.indptr)
    row = np.repeat(np.arange(len(entries)), entries)
    # the place of each entry in its row; rows are filled up with zeros to a rectangle
    place = np.arange(len(row)) - np.repeat(operator.indptr[:-1], entries)
    shape = (len(entries), max(count, int(entries.max())))
    values, columns = np.zeros(shape, dtype=np.float32), np.zeros(shape, dtype=np.int64)
    values[row, place] = np.maximum(operator.data, 0)
    columns[row, place] = operator.indices
    kept = np.argpartition(-values, count - 1, axis=1)[:, :count]
    largest = np.take_along_axis(values, kept, axis=1)
    return np.take_along_axis(columns, kept, axis=1), largest / largest.sum(axis=1, keepdims=True)


def _gradients(mesh: Mesh) -> FloatArray:
    """Gradients of the three hat functions of each face, (m, corner, 3), in 1 / length.

    They vanish on faces without area.
    """
    corners = mesh.vertices[mesh.faces]
    side = corners[:, [2, 0, 1]] - corners[:, [1, 2, 0]]
    double = face_normals(mesh)
    squared = (double**2).sum(axis=1)
    squared = np.maximum(squared, _AREA_FLOOR**2 * squared.mean())[:, None, None]
    return np.asarray(np.cross(double[:, None], side) / squared)


def _curved_most(mesh: Mesh) -> FloatArray:
    """Unit vectors (m, 3) in the faces along which the normal turns most, outward being positive.

    The shape operator of a face is the derivative of the normals of its vertices, interpolated
    linearly (Rusinkiewicz 2004); averages over the faces at each vertex smooth it.
    """
    gradient, normal = _gradients(mesh), vertex_normals(mesh)[mesh.faces]
    operator = np.einsum("fci,fcj->fij", normal, gradient)
    area, size = face_areas(mesh), len(mesh.vertices)
    corner = np.arange(mesh.faces.size) // 3
    spread = sparse.csr_array(
        (area[corner], (mesh.faces.ravel(), corner)), shape=(size, len(mesh.faces))
    )
    total = np.maximum(3 * vertex_areas(mesh), np.finfo(float).tiny)[:, None]
    for _ in range(_SMOOTHINGS):
        at_vertices = (spread @ operator.reshape(-1, 9)) / total
        operator = at_vertices[mesh.faces].mean(axis=1).reshape(-1, 3, 3)
    first = unit(mesh.vertices[mesh.faces[:, 1]] - mesh.vertices[mesh.faces[:, 0]])
    second = np.cross(unit(face_normals(mesh)), first)
    frame = np.stack([first, second], axis=1)
    (a, b), (c, d) = np.einsum("fai,fij,fbj->abf", frame, operator, frame)
    turn = np.arctan2(b + c, a - d) / 2  # of the axis of the larger eigenvalue
    return np.cos(turn)[:, None] * first + np.sin(turn)[:, None] * second
