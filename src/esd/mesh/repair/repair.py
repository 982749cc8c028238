"""What is wrong with a mesh, what that does to results, and repairs that remember the original.

Scans have holes, flipped faces, loose pieces and worse. `diagnose` names what it finds; `repair`
removes it and records which vertex became which, so that descriptors and maps computed on the
repaired mesh refer to the original vertices.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from esd.common import BoolArray, FloatArray, InputError, IntArray
from esd.mesh.convert import MeshLike, as_arrays
from esd.mesh.geometry import face_areas, face_normals, is_referenced, surface_area
from esd.mesh.mesh import Mesh, PointCloud
from esd.mesh.repair.filling import holes_filled
from esd.mesh.repair.findings import FEW_VERTICES, SMALL_HOLE, Diagnosis, Finding
from esd.mesh.repair.smoothing import smoothed
from esd.mesh.topology import (
    SLIVER,
    Sides,
    collapse_partners,
    compacted,
    cut_apart,
    fan_count,
    is_collapsed,
    is_inward,
    is_repeated,
    largest_piece,
    patches,
    piece_of_faces,
    quality,
    rims,
    seam_partners,
    sides_of,
    turned_outward,
    with_turned,
    without_repeats,
)

FILLED_AND_SMOOTHED = frozenset({"holes", "folded_edges"})
"""Findings that `restore` repairs, see `repair`."""

_FOLDED = 0.03  # share of the edges; up to half of that is ordinary in toes and ears
_SPIKE, _FEW_SPIKES = 1.2, 0.01  # of the box around nearly all vertices, and of the faces
_WHOLE = 0.9  # share of the area that must hold together for edges to be cut apart unasked
_FLIPPED = 0.9  # share of the area that was flipped, from which the shape was inside out
_FAR = 1e5  # sizes of the shape away from the origin, beyond which single precision lost its form
_LARGEST, _SMALLEST = 1e75, 1e-75  # sizes whose fourth power is still a number


@dataclass(frozen=True, slots=True, eq=False)
class Repaired:
    """A repaired shape, and which vertex became which.

    Parameters
    ----------
    shape
        A `Mesh`, or a `PointCloud` where there were no faces.
    positions : (r, 3)
        Of the repaired vertices before they were smoothed.
    vertex_index : (n,)
        The repaired vertex of each original one; -1 where it could not be carried over.
    original_index : (r,)
        The original vertex of each repaired one, for those that fill a hole one on its rim.
    filling
        How many of the last vertices of the shape fill holes.
    diagnosis
        What was found by the quick diagnosis.
    done
        Kinds of the findings that were repaired.
    is_flipped
        Whether the faces that were kept were inside out: nearly all of them were flipped.
    dropped
        Share of the area that was dropped with loose pieces.
    """

    shape: Mesh | PointCloud
    positions: npt.NDArray[np.float64]
    vertex_index: IntArray
    original_index: IntArray
    diagnosis: Diagnosis
    done: frozenset[str] = frozenset()
    filling: int = 0
    is_flipped: bool = False
    dropped: float = 0.0

    def in_a_line(self) -> str:
        """What was found, and what was done about it, in one line; empty if nothing was."""
        return ", ".join(
            finding.what + (f" ({finding.remedy})" if finding.kind in self.done else "")
            for finding in self.diagnosis.findings
        )

    def carried_back(self, values: FloatArray) -> FloatArray:
        """Values at the original vertices, (n, …), of values at the repaired ones, (r, …).

        NaN at vertices that could not be carried over.
        """
        result = np.full((len(self.vertex_index), *values.shape[1:]), np.nan)
        kept = self.vertex_index >= 0
        result[kept] = values[self.vertex_index[kept]]
        return result

    def compacted(self) -> Repaired:
        """The same without vertices that have no face."""
        if isinstance(self.shape, PointCloud):
            return self
        mesh, place = compacted(self.shape)
        return replace(
            self,
            shape=mesh,
            positions=self.positions[place >= 0],
            vertex_index=np.where(self.vertex_index >= 0, place[self.vertex_index], -1),
            original_index=self.original_index[place >= 0],
        )


def diagnose(source: MeshLike, *, thorough: bool = True) -> Diagnosis:
    """What is wrong with a mesh or a point cloud.

    Parameters
    ----------
    source
        What `as_mesh` takes, or points without faces; it need not be a mesh that `Mesh` accepts.
    thorough
        Whether faces that cut through each other are looked for, by CGAL through libigl where
        that is installed.

    Raises
    ------
    InputError
        If there are no vertices and faces in `source`.
    """
    vertices, faces = _loose_arrays(source)
    if len(faces) == 0:
        findings, patient = _examine_points(vertices)
        return Diagnosis(len(vertices), 0, _size(patient), tuple(findings))
    return _diagnosed(vertices, faces, thorough=thorough)[0]


def _diagnosed(
    vertices: npt.NDArray[np.float64], faces: IntArray, *, thorough: bool
) -> tuple[Diagnosis, Mesh | None]:
    """The diagnosis of a mesh, and what can be computed with, see `_sound`."""
    counts = len(vertices), len(faces)
    findings, mesh = _sound(vertices, faces)
    if mesh is None:
        return Diagnosis(*counts, 0.0, tuple(findings)), None
    findings += _examine(mesh)
    if thorough:
        findings += _self_intersections(mesh)
    scale = _scale(vertices[_is_finite(vertices)])
    size = _size(mesh.vertices[is_referenced(mesh)]) * scale
    return Diagnosis(*counts, size, tuple(findings)), mesh


def repair(
    source: MeshLike | Repaired,
    *,
    everything: bool = False,
    all_pieces: bool = False,
    restore: bool = False,
) -> Repaired:
    """A shape without what could be repaired, and which vertex became which.

    A mesh with nothing to repair comes back as it is. The first vertices of a repaired mesh are
    the original ones in their order; those that had to go are left without a face. Vertices at
    which sheets were cut apart keep their place on the larger sheet. Repairs of a point cloud
    leave points out.

    Parameters
    ----------
    source
        What `as_mesh` takes, or points without faces; what was repaired before stays as it is.
    everything
        Whether also what may change a sound part of the shape is done: cutting sheets apart along
        edges of more than two faces even where the shape then falls apart, leaving out faces of
        which a vertex is missing, and what `restore` does.
    all_pieces
        Whether all connected pieces are kept, and not only the one with the largest area.
    restore
        Whether small holes are filled and noise is smoothed even if not everything is repaired.
        Maps become better, while areas and lengths are no longer those measured.

    Raises
    ------
    InputError
        If nothing usable is left.
    """
    if isinstance(source, Repaired):
        return source
    vertices, faces = _loose_arrays(source)
    if len(faces) == 0:
        return _repaired_points(vertices)
    finite = _is_finite(vertices)
    named = f"'{source}': " if isinstance(source, str | os.PathLike) else ""
    if not everything:
        try:
            Mesh(np.where(finite[:, None], vertices, 0.0), faces)
        except InputError as error:  # a damaged list of faces
            raise InputError(f"{named}{error}") from error
    diagnosis, mesh = _diagnosed(vertices, faces, thorough=False)
    if mesh is None or not surface_area(mesh) > 0:
        raise InputError(f"{named}Nothing of the mesh can be used: {diagnosis.in_a_line()}.")
    done = {f.kind for f in diagnosis.findings if f.always_repaired or everything}
    if restore:
        done |= FILLED_AND_SMOOTHED & {f.kind for f in diagnosis.findings}
    if all_pieces:
        done.discard("loose_pieces")
    original = np.arange(len(vertices), dtype=np.int64)
    if done <= {"unreferenced_vertices"}:  # the very same, and so known to the caches
        mesh = Mesh(vertices, faces)
        index = np.where(is_referenced(mesh), original, -1)
        return Repaired(mesh, mesh.vertices, index, original, diagnosis, frozenset(done))
    index = np.where(finite, original, -1)
    if "duplicate_vertices" in done:
        # of the original places: moving and scaling may have rounded different ones to one
        first = seam_partners(replace(mesh, vertices=np.where(finite[:, None], vertices, 0.0)))
        mesh, index = replace(mesh, faces=first[mesh.faces]), np.where(finite, first, -1)
    if "zero_length_edges" in done:
        first = collapse_partners(replace(mesh, vertices=np.where(finite[:, None], vertices, 0.0)))
        mesh, index = replace(mesh, faces=first[mesh.faces]), np.where(finite, first[index], -1)
    mesh = without_repeats(mesh)
    at_edges = everything
    if not everything and "non_manifold_edges" in done:
        at_edges = _holds_together(mesh)
        if not at_edges:
            done.discard("non_manifold_edges")
    if everything or done & {"non_manifold_vertices", "non_manifold_edges"}:
        mesh, original = cut_apart(mesh, at_edges=at_edges)
    outward = turned_outward(mesh)
    piece = np.zeros(len(mesh.faces), dtype=np.int64) if all_pieces else piece_of_faces(mesh)
    area = face_areas(mesh)
    flipped = (outward.faces != mesh.faces).any(axis=1) & (piece == 0)
    kept_area = float(area[piece == 0].sum())
    flipped_share = float(area[flipped].sum()) / max(kept_area, np.finfo(float).tiny)
    mesh = replace(outward, faces=outward.faces[piece == 0])
    on_rim = np.zeros(0, dtype=np.int64)
    if "holes" in done:
        mesh, on_rim = holes_filled(mesh, shorter_than=SMALL_HOLE)
        original = np.concatenate([original, original[on_rim]])
    positions = mesh.vertices
    if "folded_edges" in done:
        mesh = smoothed(mesh)
    index = np.where(is_referenced(mesh)[index], index, -1)
    return Repaired(
        mesh,
        positions,
        index,
        original,
        diagnosis,
        frozenset(done),
        filling=len(on_rim),
        is_flipped=flipped_share > _FLIPPED,
        dropped=1 - kept_area / max(float(area.sum()), np.finfo(float).tiny),
    )


def _holds_together(mesh: Mesh) -> bool:
    """Whether cutting at edges of more than two faces leaves nearly all of the largest piece."""
    before, after = (
        surface_area(largest_piece(cut_apart(mesh, at_edges=cut)[0])) for cut in (False, True)
    )
    return after >= _WHOLE * before


def usable_part(source: MeshLike) -> Mesh:
    """The mesh with all its vertices, and those of its faces that can be drawn.

    Vertices with a coordinate that is no number lie at the origin; extreme coordinates are moved
    and scaled.

    Raises
    ------
    InputError
        If no face is left.
    """
    _, mesh = _sound(*_loose_arrays(source))
    if mesh is None:
        raise InputError("Nothing can be drawn: there is no face between finite vertices.")
    return mesh


def _loose_arrays(source: MeshLike) -> tuple[npt.NDArray[np.float64], IntArray]:
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


def _sound(vertices: npt.NDArray[np.float64], faces: IntArray) -> tuple[list[Finding], Mesh | None]:
    """What keeps arrays from being a mesh that can be computed with, and the mesh of the rest."""
    findings = []
    finite = _is_finite(vertices)
    findings += _found("non_finite_vertices", ~finite)
    named = ((faces >= 0) & (faces < len(vertices))).all(axis=1)
    findings += _found("missing_vertices", ~named)
    usable = faces[named]
    usable = usable[finite[usable].all(axis=1)]
    if len(usable) == 0:
        return findings, None
    spikes = _is_spike(vertices, usable)
    findings += _found("spikes", spikes)
    usable = usable[~spikes]
    used = np.zeros(len(vertices), dtype=bool)
    used[usable.ravel()] = True
    middle, scale = _middle(vertices[used]), _scale(vertices[used])
    size = _size(vertices[used] / scale)
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


def _is_finite(vertices: npt.NDArray[np.float64]) -> BoolArray:
    return np.asarray(np.isfinite(vertices).all(axis=1))


def _found(kind: str, where: Any, *, of: int | None = None) -> list[Finding]:
    """The finding of a kind where it holds, if it does anywhere; its share is `of` all."""
    index = np.flatnonzero(where)
    if len(index) == 0:
        return []
    return [Finding(kind, len(index), len(index) / (of or len(where)), int(index[0]))]


def _middle(points: FloatArray) -> FloatArray:
    return points.min(axis=0) / 2 + points.max(axis=0) / 2 if len(points) else np.zeros(3)


def _size(points: FloatArray) -> float:
    """Diagonal of the bounding box, without overflow."""
    if len(points) == 0:
        return 0.0
    return float(2 * np.hypot.reduce(points.max(axis=0) / 2 - points.min(axis=0) / 2))


def _scale(points: FloatArray) -> float:
    """What to divide by so that lengths can be squared: one for any ordinary shape."""
    if len(points) == 0:
        return 1.0
    largest = float(np.abs(points).max())
    size = _size(points)
    ordinary = largest <= _LARGEST and (size >= _SMALLEST or size == 0)
    return 1.0 if ordinary else max(largest, np.finfo(float).tiny)


def _examine(mesh: Mesh) -> list[Finding]:
    """What is wrong with the surface of a mesh."""
    findings = []
    used = is_referenced(mesh)
    findings += _found("unreferenced_vertices", ~used)
    first = seam_partners(mesh)
    findings += _found("duplicate_vertices", first != np.arange(len(used)))
    collapsed, repeated = is_collapsed(mesh.faces), is_repeated(mesh.faces)
    findings += _found("collapsed_faces", collapsed)
    findings += _found("duplicate_faces", repeated & ~collapsed)
    if not surface_area(mesh) > 0:
        return [*findings, Finding("flat_meshes", 1, 1.0)]
    # what follows is that of the surface that is computed on
    mesh = replace(mesh, faces=first[mesh.faces])
    first = collapse_partners(mesh)
    findings += _found("zero_length_edges", first != np.arange(len(used)))
    mesh = replace(mesh, faces=first[mesh.faces])
    if is_collapsed(mesh.faces).all():  # once what rounding separates is joined
        return [*findings, Finding("flat_meshes", 1, 1.0)]
    mesh = without_repeats(mesh)
    findings += _found("slivers", quality(mesh) < SLIVER)
    sides = sides_of(mesh)
    crowded = (sides.count > 2) & ~sides.next
    edge_count = int((~sides.next).sum())
    for finding in _found("non_manifold_edges", crowded, of=edge_count):
        findings.append(replace(finding, first=int(sides.start[finding.first or 0])))
    touching = _found("non_manifold_vertices", fan_count(mesh, sides) > 1)
    findings += touching
    turned, label, one_sided = patches(mesh, sides)
    pair = np.flatnonzero(sides.next & (sides.count == 2))
    alike = sides.start[pair] == sides.start[pair + 1]
    if alike.any():
        vertex = int(sides.start[pair[alike][0]])
        findings.append(
            Finding("inconsistent_winding", int(alike.sum()), alike.sum() / edge_count, vertex)
        )
    if one_sided.any():
        share = face_areas(mesh)[one_sided[label]].sum() / max(surface_area(mesh), 1e-300)
        findings.append(Finding("one_sided_pieces", int(one_sided.sum()), float(share)))
    mesh = with_turned(mesh, turned)
    findings += _folded(mesh, sides, pair)
    inward = is_inward(mesh, sides, label)
    if inward.any():
        findings.append(Finding("inside_out_pieces", int(inward.sum()), float(inward.mean())))
    findings += _holes(mesh, sides)
    findings += _pieces(cut_apart(mesh, at_edges=False)[0] if touching else mesh)
    return findings


def _folded(mesh: Mesh, sides: Sides, pair: IntArray) -> list[Finding]:
    """Edges, given as the first of their two sides, whose faces turn by more than a right angle."""
    normals = face_normals(mesh)
    f, g = sides.face[pair], sides.face[pair + 1]
    back = np.einsum("ij,ij->i", normals[f], normals[g]) < 0
    if back.mean() < _FOLDED if len(back) else True:
        return []
    vertex = int(sides.start[pair[back][0]])
    return [Finding("folded_edges", int(back.sum()), float(back.mean()), vertex)]


def _holes(mesh: Mesh, sides: Sides) -> list[Finding]:
    rim, length = rims(mesh, sides)
    if len(length) == 0:
        return []
    root = max(surface_area(mesh) ** 0.5, np.finfo(float).tiny)
    return [Finding("holes", len(length), float(length.max() / root), int(rim[0, 0]))]


def _pieces(mesh: Mesh) -> list[Finding]:
    label = piece_of_faces(mesh)
    area = np.bincount(label, weights=face_areas(mesh))
    findings = []
    if len(area) > 1:
        share = 1 - area[0] / max(area.sum(), np.finfo(float).tiny)
        first = int(mesh.faces[label > 0][0, 0])
        findings.append(Finding("loose_pieces", len(area) - 1, float(share), first))
    count = len(np.unique(mesh.faces[label == 0]))
    if count < FEW_VERTICES:
        findings.append(Finding("few_vertices", 1, 1 - count / FEW_VERTICES))
    return findings


def _self_intersections(mesh: Mesh) -> list[Finding]:
    try:
        from igl.copyleft import cgal
    except ImportError:
        return []
    faces = mesh.faces[~is_collapsed(mesh.faces) & (face_areas(mesh) > 0)]
    if len(faces) == 0:
        return []
    pairs = cgal.remesh_self_intersections(np.array(mesh.vertices), faces, detect_only=True)[2]
    if len(pairs) == 0:
        return []
    return [
        Finding(
            "self_intersections",
            len(pairs),
            len(np.unique(pairs)) / len(mesh.faces),
            int(faces[pairs[0, 0], 0]),
        )
    ]


def can_find_self_intersections() -> bool:
    """Whether libigl, which finds faces that cut through each other, is installed."""
    from importlib.util import find_spec

    return find_spec("igl") is not None


def _examine_points(
    vertices: npt.NDArray[np.float64],
) -> tuple[list[Finding], npt.NDArray[np.float64]]:
    """What is wrong with points, and those that are finite, once each, in their order."""
    finite = _is_finite(vertices)
    findings = _found("non_finite_vertices", ~finite)
    points = vertices[finite] + 0.0
    _, first = np.unique(points, axis=0, return_index=True)
    repeated = np.ones(len(points), dtype=bool)
    repeated[first] = False
    findings += _found("duplicate_vertices", repeated, of=len(vertices))
    if len(first) < FEW_VERTICES:
        findings.append(Finding("few_vertices", 1, 1 - len(first) / FEW_VERTICES))
    return findings, points[np.sort(first)]


def _repaired_points(vertices: npt.NDArray[np.float64]) -> Repaired:
    findings, points = _examine_points(vertices)
    diagnosis = Diagnosis(len(vertices), 0, _size(points), tuple(findings))
    if len(points) == 0:
        raise InputError("None of its points has three finite coordinates; export it anew.")
    finite = _is_finite(vertices)
    _, first, inverse = np.unique(
        vertices[finite] + 0.0, axis=0, return_index=True, return_inverse=True
    )
    order = np.argsort(first)
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    index = np.full(len(vertices), -1, dtype=np.int64)
    index[finite] = rank[inverse.reshape(-1)]
    scale = _scale(points)
    original = np.flatnonzero(finite)[first[order]]
    done = frozenset(finding.kind for finding in findings if finding.always_repaired)
    cloud = PointCloud(points / scale)
    return Repaired(cloud, cloud.vertices, index, original, diagnosis, done)
