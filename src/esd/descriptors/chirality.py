"""Products of the gradients of two fields: the odd one tells left from right."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, TypeAlias

import numpy as np
from scipy import sparse

from esd.common import FloatArray, InputError, IntArray
from esd.mesh.mesh import Mesh
from esd.mesh.topology import SLIVER, has_orientation, quality
from esd.spectral.laplacian import cotangents
from esd.spectral.spectrum import Spectrum

Parity: TypeAlias = Literal["odd", "even"]

_FLOOR = 0.01  # of a field's mean squared gradient, below which its direction means nothing


def neighbour_pairs(count: int, *, reach: int) -> IntArray:
    """Pairs (p, 2) of each of `count` fields with the `reach` fields after it."""
    pairs = [(i, j) for i in range(count) for j in range(i + 1, min(i + 1 + reach, count))]
    return np.array(pairs, dtype=np.int64).reshape(-1, 2)


def gradient_products(
    mesh: Mesh,
    spectrum: Spectrum,
    fields: FloatArray,
    *,
    pairs: IntArray,
    times: FloatArray,
    parity: Parity,
) -> FloatArray:
    """Sine or cosine of the angle between the gradients of two fields, smoothed, (n, t · p).

    With n the outward normal, and D_t the diffusion over time t,

        odd:  χ = D_t⟨n, ∇f × ∇g⟩ / √(D_t|∇f|² · D_t|∇g|²)
        even: η = D_t⟨∇f, ∇g⟩ / √(D_t|∇f|² · D_t|∇g|²)

    Both are unchanged by rotations, scaling, isometries that keep the orientation, and by a
    factor on f or g. A reflection, or turning the normals, changes the sign of the odd one and
    leaves the even one. Functions of squared eigenfunctions, such as HKS and WKS, are equal at
    points that mirror each other; χ of two of them is not.

    ⟨n, ∇f × ∇g⟩ dA is the two-form df ∧ dg, whose integral over a triangle is half the determinant
    of the differences of f and g along two sides, whatever the lengths of the sides. ⟨∇f, ∇g⟩ of
    slivers is not counted. Smoothing before division, not after it, keeps noise small where a
    gradient vanishes.

    Parameters
    ----------
    mesh
        Consistently oriented, and outward for the sign to be comparable between shapes.
    fields : (n, c)
        Values at the vertices.
    pairs : (p, 2)
        Columns of `fields`, f and g of each product.
    times : (t,)
        As shares of the area of the shape. The result has all pairs at the first time first.

    Raises
    ------
    InputError
        If the mesh is inconsistently oriented, so that no side is outward, or the spectrum is
        not of the mesh.
    """
    if len(spectrum.mass) != len(mesh.vertices) or len(fields) != len(mesh.vertices):
        raise InputError(
            f"The mesh has {len(mesh.vertices)} vertices, the spectrum {len(spectrum.mass)} and "
            f"the fields {len(fields)}: they are not of one shape."
        )
    if parity == "odd" and not has_orientation(mesh):
        raise InputError(
            "The mesh is inconsistently oriented, so that its outside is not defined, and left and "
            "right cannot be distinguished. Repair it first (esd doctor MESH --repair OUT), or use "
            "a model of HKS or WKS alone."
        )
    f, g = pairs.T
    dtype = spectrum.eigenvectors.dtype
    to_vertices = _thirds(mesh).astype(dtype)
    # differences in 64 bits: neighbours differ little
    steps = [
        (fields[mesh.faces[:, i - 1]] - fields[mesh.faces[:, i - 2]]).astype(dtype, copy=False)
        for i in range(3)
    ]
    # across a sliver a gradient is a small difference over a smaller length: mostly error
    weights = np.where(quality(mesh)[:, None] < SLIVER, 0.0, cotangents(mesh)).astype(dtype)
    every = np.arange(fields.shape[1])
    squared = to_vertices @ _inner(weights, steps, every, every)
    product = to_vertices @ (
        _wedge(steps, f, g) if parity == "odd" else _inner(weights, steps, f, g)
    )
    area, vectors = spectrum.area, spectrum.eigenvectors
    floor = (_FLOOR * squared.sum(axis=0) / area).astype(vectors.dtype)
    decay = np.exp(-area * spectrum.eigenvalues[:, None] * times)[:, :, None]
    decay = decay.astype(vectors.dtype)

    def diffused(values: FloatArray) -> FloatArray:
        """Over all times, (n, t, columns), in the precision of the eigenvectors."""
        smoothed = decay * (vectors.T @ values.astype(vectors.dtype, copy=False))[:, None]
        return (vectors @ smoothed.reshape(len(smoothed), -1)).reshape(len(vectors), len(times), -1)

    size = np.sqrt(np.maximum(diffused(squared), floor))
    result = diffused(product)
    for i in range(len(times)):  # one at a time, for the memory that dense meshes take
        result[:, i] /= np.maximum(size[:, i, f] * size[:, i, g], np.finfo(vectors.dtype).tiny)
    return result.reshape(len(result), -1)


def _thirds(mesh: Mesh) -> sparse.csr_array:
    """The matrix (n, m) that gives each corner of a face a third of the face's integral."""
    faces = np.repeat(np.arange(len(mesh.faces)), 3)
    third = np.full(len(faces), 1 / 3)
    shape = (len(mesh.vertices), len(mesh.faces))
    return sparse.coo_array((third, (mesh.faces.ravel(), faces)), shape=shape).tocsr()


def _wedge(steps: Sequence[FloatArray], f: IntArray, g: IntArray) -> FloatArray:
    """Integral of df ∧ dg over each face, (m, p), of fields with differences along its sides."""
    result = steps[0][:, f] * steps[1][:, g]
    result -= steps[1][:, f] * steps[0][:, g]
    return result / 2


def _inner(
    weights: FloatArray, steps: Sequence[FloatArray], f: IntArray, g: IntArray
) -> FloatArray:
    """Integral of ⟨∇f, ∇g⟩ over each face, (m, p), by the cotangents opposite its sides."""
    result = np.zeros((len(weights), len(f)), dtype=weights.dtype)
    for side, step in enumerate(steps):
        scaled = (weights[:, side, None] / 2 * step)[:, f]
        scaled *= step[:, g]
        result += scaled
    return result
