"""Parts of whole shapes, with exact index maps: without balls, beyond planes, in single views."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from esd.common import BoolArray, FloatArray, InputError, IntArray
from esd.datasets.collection import Shape
from esd.mesh.geodesics import geodesic_graph
from esd.mesh.geometry import edge_lengths, face_areas, face_normals, is_referenced, surface_area
from esd.mesh.mesh import Mesh
from esd.mesh.topology import compacted, largest_piece

_GRAZING = 0.2  # cosine between a face and the line of sight, below which no depth is measured
_FINEST = 32  # samples along an edge, at the most
_AWAY = 4.0  # distance of random cameras, in units of the shape's radius


@dataclass(frozen=True, slots=True, eq=False)
class Perturbed:
    """A changed mesh, and which vertex became which.

    Parameters
    ----------
    mesh
        All of its vertices have a face.
    vertex_index : (n,)
        The vertex here of each vertex of the original; -1 where it is gone.
    """

    mesh: Mesh
    vertex_index: IntArray

    def original_index(self) -> IntArray:
        """The vertex of the original that each vertex here was, (m,), the first where several."""
        kept = np.flatnonzero(self.vertex_index >= 0)[::-1]  # so that the first is written last
        index = np.full(len(self.mesh.vertices), -1, dtype=np.int64)
        index[self.vertex_index[kept]] = kept
        return index


def part_with(mesh: Mesh, keep: BoolArray) -> Perturbed:
    """The largest piece of the faces to keep, (m,).

    Raises
    ------
    InputError
        If no face is left.
    """
    if not keep.any():
        raise InputError("Nothing is left of the mesh; take less away.")
    return Perturbed(*compacted(largest_piece(Mesh(mesh.vertices, mesh.faces[keep]))))


def outside_balls(mesh: Mesh, count: int, radius: float, *, seed: int = 0) -> BoolArray:
    """Which faces are left, (m,), where geodesic balls around random vertices are removed.

    As PFAUST was made from FAUST (Bracha et al. 2023): its medium shapes lack four balls of radius
    0.16, its hard ones thirteen of 0.10.

    Parameters
    ----------
    radius
        In units of √area.

    Raises
    ------
    InputError
        If the count is below one or the radius not positive.
    """
    if count < 1 or not radius > 0:
        raise InputError(
            f"`count` must be at least 1 and `radius` positive; got {count} and {radius}."
        )
    used = np.flatnonzero(is_referenced(mesh))
    centres = np.random.default_rng(seed).choice(used, size=min(count, len(used)), replace=False)
    reach = radius * surface_area(mesh) ** 0.5
    is_inside = np.isfinite(geodesic_graph(mesh).distances_to_any(centres, limit=reach))
    return np.asarray(~is_inside[mesh.faces].any(axis=1))


def beyond_plane(mesh: Mesh, share: float, *, seed: int = 0) -> BoolArray:
    """Which faces lie beyond a plane of random direction, (m,).

    Parameters
    ----------
    share
        Of the area that lies before it.

    Raises
    ------
    InputError
        If the share is not from 0 to below 1.
    """
    check_level(share, 1)
    direction = np.random.default_rng(seed).standard_normal(3)
    height = mesh.vertices[mesh.faces].mean(axis=1) @ direction
    order = np.argsort(height)
    area = face_areas(mesh)
    keep = np.ones(len(height), dtype=bool)
    keep[order[np.cumsum(area[order]) <= share * area.sum()]] = False
    return keep


def in_view(mesh: Mesh, eye: FloatArray) -> BoolArray:
    """Which faces a depth camera sees, (m,): none is behind another or nearly edge-on.

    By a buffer of depths whose pixels are half as wide as the mean edge, so that edges of what
    occludes are ragged.

    Parameters
    ----------
    eye : (3,)
        Where the camera is; it looks at the middle of the bounding box.

    Raises
    ------
    InputError
        If it is not outside the ball around the shape.
    """
    used = mesh.vertices[is_referenced(mesh)]
    middle = (used.min(axis=0) + used.max(axis=0)) / 2
    reach = float(np.linalg.norm(used - middle, axis=1).max())
    away = float(np.linalg.norm(np.asarray(eye) - middle))
    if away <= reach:
        raise InputError(
            f"The camera must be outside the ball around the shape, {reach:.3g} from its middle; "
            f"it is {away:.3g} away."
        )
    axes = np.linalg.qr(np.column_stack([middle - eye, np.eye(3)]))[0].T  # the first: to the middle
    axes[0] *= np.sign(axes[0] @ (middle - eye))
    width = 0.5 * float(edge_lengths(mesh).mean())

    def projected(points: FloatArray) -> tuple[IntArray, FloatArray]:
        depth, *across = axes @ (points - eye).T
        return np.floor(np.stack(across) / depth * away / width).astype(np.int64), depth

    pixel, depth = projected(_samples(mesh, width))
    low = pixel.min(axis=1)
    height, length = (pixel.max(axis=1) - low + 1).tolist()
    nearest = np.full(height * length, np.inf)
    np.minimum.at(nearest, (pixel[0] - low[0]) * length + pixel[1] - low[1], depth)

    pixel, depth = projected(mesh.vertices)
    row, column = np.clip(pixel - low[:, None], 0, [[height - 1], [length - 1]])
    # within a pixel, the depth of a face that is nearly edge-on differs by so much
    is_seen = depth <= nearest[row * length + column] + width / _GRAZING
    sight = eye - mesh.vertices[mesh.faces].mean(axis=1)
    sight /= np.linalg.norm(sight, axis=1, keepdims=True)
    normals = face_normals(mesh)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), np.finfo(float).tiny)
    facing = np.einsum("ij,ij->i", normals, sight) > _GRAZING
    return facing & is_seen[mesh.faces].all(axis=1)


def random_eye(mesh: Mesh, *, seed: int = 0) -> FloatArray:
    """Where a camera could be, (3,), in a random direction from the middle of the bounding box."""
    used = mesh.vertices[is_referenced(mesh)]
    middle = (used.min(axis=0) + used.max(axis=0)) / 2
    direction = np.random.default_rng(seed).standard_normal(3)
    reach = float(np.linalg.norm(used - middle, axis=1).max())
    return np.asarray(middle + _AWAY * reach * direction / np.linalg.norm(direction))


def _samples(mesh: Mesh, spacing: float) -> FloatArray:
    """Points on all faces, at most about so far from each other."""
    corners = mesh.vertices[mesh.faces]
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    count = np.clip(np.ceil(longest / spacing), 1, _FINEST).astype(int)
    samples = []
    for n in np.unique(count):
        i, j = (grid.ravel() for grid in np.meshgrid(np.arange(n + 1), np.arange(n + 1)))
        weights = np.stack([i, j, n - i - j], axis=1)[i + j <= n] / n
        samples.append(np.einsum("sc,fcd->fsd", weights, corners[count == n]).reshape(-1, 3))
    return np.concatenate(samples)


PARTS: dict[str, Callable[[Mesh, int], BoolArray]] = {
    "balls, medium": lambda mesh, seed: outside_balls(mesh, 4, 0.16, seed=seed),
    "balls, hard": lambda mesh, seed: outside_balls(mesh, 13, 0.10, seed=seed),
    "cut of 10 %": lambda mesh, seed: beyond_plane(mesh, 0.1, seed=seed),
    "cut of 20 %": lambda mesh, seed: beyond_plane(mesh, 0.2, seed=seed),
    "cut of 35 %": lambda mesh, seed: beyond_plane(mesh, 0.35, seed=seed),
    "cut of 50 %": lambda mesh, seed: beyond_plane(mesh, 0.5, seed=seed),
    "view": lambda mesh, seed: in_view(mesh, random_eye(mesh, seed=seed)),
    "cut of 20 % and balls": lambda mesh, seed: (
        beyond_plane(mesh, 0.2, seed=seed) & outside_balls(mesh, 4, 0.10, seed=seed + 1)
    ),
    "view and balls": lambda mesh, seed: (
        in_view(mesh, random_eye(mesh, seed=seed)) & outside_balls(mesh, 4, 0.10, seed=seed + 1)
    ),
}
"""Which faces are left of a mesh by a seed; the first two are those of PFAUST."""


def part_of(mesh: Mesh, kind: str, *, seed: int = 0) -> Perturbed:
    """A part of a mesh, of one of the kinds in `PARTS`; its largest piece.

    Raises
    ------
    InputError
        If there is no such kind, or nothing is left.
    """
    if kind not in PARTS:
        raise InputError(f"There are no parts of kind '{kind}'; there are {', '.join(PARTS)}.")
    return part_with(mesh, PARTS[kind](mesh, seed))


def part_of_shape(shape: Shape, kind: str, *, seed: int = 0) -> Shape:
    """The same of a shape of a collection; its points of the template are -1 where it lacks them.

    Raises
    ------
    InputError
        If there is no such kind.
    """
    if kind not in PARTS:
        raise InputError(f"There are no parts of kind '{kind}'; there are {', '.join(PARTS)}.")
    made = partial(_part_of_read, shape.mesh, kind, seed)
    return replace(
        shape,
        name=f"{shape.name}, {kind}, {seed}",
        mesh=partial(_mesh_of, made),
        correspondence=partial(_points_of, made, shape.correspondence),
        symmetric=None if shape.symmetric is None else partial(_points_of, made, shape.symmetric),
    )


def _part_of_read(mesh: Callable[[], Mesh], kind: str, seed: int) -> Perturbed:
    return part_of(mesh(), kind, seed=seed)


def _mesh_of(made: Callable[[], Perturbed]) -> Mesh:
    return made().mesh


def _points_of(made: Callable[[], Perturbed], points: Callable[[], IntArray]) -> IntArray:
    index = points()
    return np.where(index >= 0, made().vertex_index[index], -1)


def check_level(level: float, below: float) -> None:
    """Raise an `InputError` if a level is not from 0 to below a bound."""
    if not 0 <= level < below:
        raise InputError(f"`level` must be from 0 to below {below}; got {level}.")
