"""Arrays that may be no mesh yet: their form, and the part of them that can be computed with."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from esd.common import BoolArray, FloatArray, InputError, IntArray
from esd.mesh.convert import MeshLike, as_arrays
from esd.mesh.mesh import Mesh
from esd.mesh.repair.findings import Finding

_SPIKE, _FEW_SPIKES = 1.2, 0.01  # of the box around nearly all vertices, and of the faces
_FAR = 1e5  # sizes of the shape away from the origin, beyond which single precision lost its form
_LARGEST, _SMALLEST = 1e75, 1e-75  # sizes whose fourth power is still a number


def loose_arrays(source: MeshLike) -> tuple[npt.NDArray[np.float64], IntArray]:
    """Vertices and faces of the right shapes and types, whatever their values."""
    vertices, faces = as_arrays(source)
    try:
        vertices = np.array(vertices, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(
            "`vertices` must be numbers of shape (n, 3); got words, or rows of different lengths."
        ) from error
    try:
        faces = np.asarray(faces)
    except ValueError as error:
        raise InputError(
            "`faces` must have shape (m, 3); got rows of different lengths. Cut polygons into "
            "triangles first."
        ) from error
    for name, array, letter in (("vertices", vertices, "n"), ("faces", faces, "m")):
        if array.ndim != 2 or array.shape[1] != 3:
            raise InputError(f"`{name}` must have shape ({letter}, 3); got {array.shape}.")
    if faces.dtype.kind not in "iu":
        raise InputError(f"`faces` must be integers; got {faces.dtype}.")
    return vertices, faces.astype(np.int64)


def sound_part(
    vertices: npt.NDArray[np.float64], faces: IntArray
) -> tuple[list[Finding], Mesh | None]:
    """What keeps arrays from being a mesh that can be computed with, and the mesh of the rest."""
    findings = []
    finite = is_finite(vertices)
    findings += found("non_finite_vertices", ~finite)
    named = ((faces >= 0) & (faces < len(vertices))).all(axis=1)
    findings += found("missing_vertices", ~named)
    usable = faces[named]
    usable = usable[finite[usable].all(axis=1)]
    if len(usable) == 0:
        return findings, None
    spikes = _is_spike(vertices, usable)
    findings += found("spikes", spikes)
    usable = usable[~spikes]
    used = np.zeros(len(vertices), dtype=bool)
    used[usable.ravel()] = True
    middle, scale = _middle(vertices[used]), safe_scale(vertices[used])
    size = diagonal(vertices[used] / scale)
    if scale != 1 or (size > 0 and np.abs(middle).max() > _FAR * size):
        findings.append(Finding("extreme_coordinates", 1, 1.0))
        # vertices without a face may be so far away that they overflow
        vertices = np.where(used[:, None], vertices, 0.0) / scale - middle / scale
    return findings, Mesh(np.where(finite[:, None], vertices, 0.0), usable)


def _is_spike(vertices: npt.NDArray[np.float64], faces: IntArray) -> BoolArray:
    """Whether each face has an edge longer than the box that holds nearly all vertices, (m,).

    The box leaves out a hundredth of the used vertices on either side of each axis. Where more
    than a hundredth of the faces is as long, none is a spike: the shape is of such faces.
    """
    points = vertices[np.unique(faces)]
    low, high = np.quantile(points / 4, [0.01, 0.99], axis=0)  # a quarter never overflows
    box = np.hypot.reduce(high - low)
    corners = vertices[faces] / 4
    length = np.hypot.reduce(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    found = length > _SPIKE * box
    return np.asarray(found & (found.mean() <= _FEW_SPIKES))


def is_finite(vertices: npt.NDArray[np.float64]) -> BoolArray:
    """Whether all coordinates of each vertex are numbers, (n,)."""
    return np.asarray(np.isfinite(vertices).all(axis=1))


def found(kind: str, where: Any, *, of: int | None = None) -> list[Finding]:
    """The finding of a kind where it holds, if it does anywhere; its share is `of` all."""
    index = np.flatnonzero(where)
    if len(index) == 0:
        return []
    return [Finding(kind, len(index), len(index) / (of or len(where)), int(index[0]))]


def _middle(points: FloatArray) -> FloatArray:
    """Middle of the bounding box, without overflow."""
    return points.min(axis=0) / 2 + points.max(axis=0) / 2 if len(points) else np.zeros(3)


def diagonal(points: FloatArray) -> float:
    """Diagonal of the bounding box, without overflow."""
    if len(points) == 0:
        return 0.0
    return float(2 * np.hypot.reduce(points.max(axis=0) / 2 - points.min(axis=0) / 2))


def safe_scale(points: FloatArray) -> float:
    """What to divide by so that lengths can be squared: one for any ordinary shape."""
    if len(points) == 0:
        return 1.0
    largest = float(np.abs(points).max())
    size = diagonal(points)
    ordinary = largest <= _LARGEST and (size >= _SMALLEST or size == 0)
    return 1.0 if ordinary else max(largest, np.finfo(float).tiny)
