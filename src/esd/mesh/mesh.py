"""The triangle mesh and the point cloud: data and its validation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from esd.common import InputError, IntArray


@dataclass(frozen=True, slots=True, eq=False)
class Mesh:
    """A triangle mesh in three dimensions.

    Both arrays are copied, converted and made read-only.

    Parameters
    ----------
    vertices : (n, 3) float64
        Positions, in any unit of length. All finite.
    faces : (m, 3) int64
        Vertex indices from 0, counter-clockwise seen from outside. m is at least one.

    Raises
    ------
    InputError
        If a shape, a type, a coordinate or an index is not as described.
    """

    vertices: npt.NDArray[np.float64]
    faces: IntArray

    def __post_init__(self) -> None:
        object.__setattr__(self, "vertices", _checked_vertices(self.vertices))
        object.__setattr__(self, "faces", _checked_faces(self.faces, len(self.vertices)))

    def __repr__(self) -> str:
        return f"<Mesh of {len(self.vertices)} vertices and {len(self.faces)} faces>"


@dataclass(frozen=True, slots=True, eq=False)
class PointCloud:
    """Points of a surface whose triangles are not known.

    Parameters
    ----------
    vertices : (n, 3) float64
        Positions, in any unit of length. All finite. Copied and made read-only.

    Raises
    ------
    InputError
        If the shape, the type or a coordinate is not as described.
    """

    vertices: npt.NDArray[np.float64]

    def __post_init__(self) -> None:
        object.__setattr__(self, "vertices", _checked_vertices(self.vertices))

    def __repr__(self) -> str:
        return f"<PointCloud of {len(self.vertices)} points>"


def _checked_vertices(vertices: npt.ArrayLike) -> npt.NDArray[np.float64]:
    try:
        array = np.array(vertices, dtype=np.float64, order="C")
    except (TypeError, ValueError) as error:
        raise InputError(
            "`vertices` must be numbers of shape (n, 3); got words, or rows of different lengths."
        ) from error
    if array.ndim != 2 or array.shape[1] != 3:
        hint = " Transpose it?" if array.ndim == 2 and array.shape[0] == 3 else ""
        raise InputError(f"`vertices` must have shape (n, 3); got {array.shape}.{hint}")
    bad = np.flatnonzero(~np.isfinite(array).all(axis=1))
    if len(bad):
        raise InputError(
            f"`vertices` must be finite; {len(bad)} are not, the first is vertex {bad[0]}: "
            f"{array[bad[0]].tolist()}."
        )
    array.flags.writeable = False
    return array


def _checked_faces(faces: npt.ArrayLike, vertex_count: int) -> IntArray:
    try:
        array = np.asarray(faces)
    except ValueError as error:
        raise InputError(
            "`faces` must have shape (m, 3); got rows of different lengths. Cut polygons into "
            "triangles first."
        ) from error
    if array.ndim != 2 or array.shape[1] != 3:
        hint = " Transpose it?" if array.ndim == 2 and array.shape[0] == 3 else ""
        raise InputError(f"`faces` must have shape (m, 3); got {array.shape}.{hint}")
    if len(array) == 0:
        raise InputError("The mesh has no faces; a surface is needed, not a point cloud.")
    if array.dtype.kind not in "iu":
        raise InputError(f"`faces` must be integers; got {array.dtype}.")
    array = np.array(array, dtype=np.int64, order="C")
    bad = np.flatnonzero(((array < 0) | (array >= vertex_count)).any(axis=1))
    if len(bad):
        raise InputError(
            f"`faces` must hold indices from 0 to {vertex_count - 1}; {len(bad)} do not, "
            f"the first is face {bad[0]}: {array[bad[0]].tolist()}."
        )
    array.flags.writeable = False
    return array
