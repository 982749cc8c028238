"""What is wrong with a mesh, what that does to results, and repairs that remember the original.

Scans have holes, flipped faces, loose pieces and worse. `diagnose` names what it finds; `repair`
removes it and records which vertex became which, so that descriptors and maps computed on the
repaired mesh refer to the original vertices.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from esd.common import BoolArray, FloatArray, InputError, IntArray
from esd.mesh.convert import MeshLike
from esd.mesh.geometry import face_areas, is_referenced, surface_area
from esd.mesh.mesh import Mesh, PointCloud
from esd.mesh.repair.arrays import diagonal, is_finite, loose_arrays, safe_scale, sound_part
from esd.mesh.repair.diagnose import diagnosed, examine_points
from esd.mesh.repair.filling import holes_filled
from esd.mesh.repair.findings import SMALL_HOLE, Diagnosis, Finding
from esd.mesh.repair.joining import collapse_partners, cut_apart, seam_partners
from esd.mesh.repair.pieces import is_ground, stand_ins
from esd.mesh.repair.smoothing import smoothed
from esd.mesh.repair.wrapping import pieces_within, surface_around
from esd.mesh.topology import (
    compacted,
    largest_piece,
    oriented_outward,
    piece_of_faces,
    without_repeats,
)

FILLED_AND_SMOOTHED = frozenset({"holes", "folded_edges"})
"""Findings that `restore` repairs, see `repair`."""

_WRAPPED = FILLED_AND_SMOOTHED | {"slivers", "few_vertices"}
"""Findings that a surface around the pieces does not have."""

_AROUND = 10_000  # vertices of a surface around several pieces
_LOST = 0.05  # share of the vertices that pieces matched together must have more than the largest
_WHOLE = 0.9  # share of the area that must hold together for edges to be cut apart unasked
_FLIPPED = 0.9  # share of the area that was flipped, from which the shape was inside out


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
    stand_in : (n,)
        Of each original vertex on a piece that was dropped, the nearest repaired one, if it is
        near; -1 for all others.
    filling
        How many of the last vertices of the shape fill holes.
    diagnosis
        What was found by the quick diagnosis.
    done
        Kinds of the findings that were repaired.
    is_flipped
        Whether the faces that were kept were inside out: nearly all of them were flipped.
    lost
        Share of the original vertices with a face that were dropped with loose pieces, and have
        no `stand_in`.
    around
        The closed surface around several pieces, in whose place it is matched; None for others.
    """

    shape: Mesh | PointCloud
    positions: npt.NDArray[np.float64]
    vertex_index: IntArray
    original_index: IntArray
    stand_in: IntArray
    diagnosis: Diagnosis
    done: frozenset[str] = frozenset()
    filling: int = 0
    is_flipped: bool = False
    lost: float = 0.0
    around: Mesh | None = None

    def __repr__(self) -> str:
        return f"<Repaired {str(self.shape).strip('<>')} of {len(self.vertex_index)} vertices>"

    def in_a_line(self) -> str:
        """What was found, and what was done about it, in one line; empty if nothing was."""
        return ", ".join(
            finding.what + (f" ({self._remedy(finding)})" if finding.kind in self.done else "")
            for finding in self.diagnosis.findings
        )

    def _remedy(self, finding: Finding) -> str:
        is_joined = self.around is not None and finding.kind == "loose_pieces"
        return "those that touch are matched together" if is_joined else finding.remedy

    def not_repaired(self) -> str:
        """What does harm and was not repaired, in one line; empty if there is nothing."""
        return ", ".join(
            finding.what
            for finding in self.diagnosis.findings
            if finding.severity != "harmless"
            and not (self.around is not None and finding.kind in _WRAPPED)
            and (finding.kind not in self.done or _is_large_hole(finding))
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
            stand_in=np.where(self.stand_in >= 0, place[self.stand_in], -1),
        )


def repair(
    source: MeshLike | Repaired,
    *,
    everything: bool = False,
    all_pieces: bool = False,
    restore: bool = False,
    together: bool = False,
    dense: int | None = None,
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
        non-manifold edges even where the shape then falls apart, leaving out faces of
        which a vertex is missing, and what `restore` does.
    all_pieces
        Whether all connected pieces are kept, the ground too, and not only the largest by area.
    restore
        Whether small holes are filled and noise is smoothed even if not everything is repaired.
        Maps become better, while areas and lengths are no longer those measured.
    together
        Whether pieces that touch are all kept, with a closed surface around them, where the
        largest alone leaves out too much. Holes are not filled then, nor noise smoothed.
    dense
        Number of vertices beyond which everything is repaired, since meshes that are to be
        remeshed must be sound; the list of faces must be in any case.

    Raises
    ------
    InputError
        If nothing usable is left.
    """
    if isinstance(source, Repaired):
        return source
    vertices, faces = loose_arrays(source)
    if len(faces) == 0:
        return _repaired_points(vertices)
    named = f"'{source}': " if isinstance(source, str | os.PathLike) else ""
    if not everything:
        _check_faces(vertices, faces, named)
        everything = dense is not None and len(vertices) > dense
    diagnosis, mesh = diagnosed(vertices, faces, thorough=False)
    if mesh is None or not surface_area(mesh) > 0:
        raise InputError(f"{named}Nothing of the mesh can be used: {diagnosis.in_a_line()}.")
    done = {f.kind for f in diagnosis.findings if f.always_repaired or everything}
    if restore:
        done |= FILLED_AND_SMOOTHED & {f.kind for f in diagnosis.findings}
    if all_pieces:
        done -= {"loose_pieces", "ground_planes"}
    original = np.arange(len(vertices), dtype=np.int64)
    if done <= {"unreferenced_vertices"}:  # the very same, and so known to the caches
        mesh = Mesh(vertices, faces)
        index = np.where(is_referenced(mesh), original, -1)
        none = np.full(len(index), -1)
        return Repaired(mesh, mesh.vertices, index, original, none, diagnosis, frozenset(done))
    mesh, index = _joined(mesh, vertices, done)
    if not everything and "non_manifold_edges" in done and not _holds_together(mesh):
        done.discard("non_manifold_edges")
    if everything or done & {"non_manifold_vertices", "non_manifold_edges"}:
        mesh, original = cut_apart(mesh, at_edges=everything or "non_manifold_edges" in done)
    if "ground_planes" in done:
        mesh = replace(mesh, faces=mesh.faces[~is_ground(mesh)])
    whole, outward = mesh, oriented_outward(mesh)
    chosen = _pieces_chosen(whole, outward, index, all_pieces=all_pieces, together=together)
    if chosen.around is not None:
        done -= FILLED_AND_SMOOTHED
    mesh = replace(outward, faces=outward.faces[chosen.faces])
    on_rim = np.zeros(0, dtype=np.int64)
    if "holes" in done:
        mesh, on_rim = holes_filled(mesh, shorter_than=SMALL_HOLE)
        original = np.concatenate([original, original[on_rim]])
    positions = mesh.vertices
    if "folded_edges" in done:
        mesh = smoothed(mesh)
    return Repaired(
        mesh,
        positions,
        chosen.index,
        original,
        chosen.stand_in,
        diagnosis,
        frozenset(done),
        filling=len(on_rim),
        is_flipped=_flipped_share(whole, outward, chosen.faces) > _FLIPPED,
        lost=chosen.lost,
        around=chosen.around,
    )


def _check_faces(vertices: npt.NDArray[np.float64], faces: IntArray, named: str) -> None:
    """Refuse a damaged list of faces."""
    try:
        Mesh(np.where(is_finite(vertices)[:, None], vertices, 0.0), faces)
    except InputError as error:
        raise InputError(f"{named}{error}") from error


def _joined(mesh: Mesh, vertices: npt.NDArray[np.float64], done: set[str]) -> tuple[Mesh, IntArray]:
    """The mesh with seams and edges without length joined, and what each vertex became, (n,)."""
    finite = is_finite(vertices)
    index = np.where(finite, np.arange(len(vertices)), -1)
    # by the original places: moving and scaling may have rounded different ones to one
    places = np.where(finite[:, None], vertices, 0.0)
    for kind, partners in (
        ("duplicate_vertices", seam_partners),
        ("zero_length_edges", collapse_partners),
    ):
        if kind in done:
            first = partners(replace(mesh, vertices=places))
            # a vertex that was joined before is joined on with its representative
            mesh = replace(mesh, faces=first[mesh.faces])
            index = np.where(finite, first[index], -1)
    return without_repeats(mesh), index


def _flipped_share(before: Mesh, after: Mesh, is_kept: BoolArray) -> float:
    """Share of the area of the faces that are kept, (m,), whose corners have another order."""
    area = np.where(is_kept, face_areas(before), 0.0)
    flipped = (after.faces != before.faces).any(axis=1)
    return float(area[flipped].sum() / max(area.sum(), np.finfo(float).tiny))


@dataclass(frozen=True, slots=True, eq=False)
class _Pieces:
    """Which pieces of a mesh are kept.

    Parameters
    ----------
    faces : (m,)
        Whether each face is.
    index : (n,)
        What each original vertex became, with -1 for those of other pieces and without a face.
    stand_in, lost
        Of the vertices on other pieces, see `Repaired`.
    around
        The closed surface around those that are kept, if they are several that touch.
    """

    faces: BoolArray
    index: IntArray
    stand_in: IntArray
    lost: float
    around: Mesh | None = None


def _pieces_chosen(
    whole: Mesh, outward: Mesh, index: IntArray, *, all_pieces: bool, together: bool
) -> _Pieces:
    """The pieces that are kept of a mesh, whose faces are oriented outward in `outward`."""
    if all_pieces:
        return _pieces_of(whole, np.ones(len(whole.faces), dtype=bool), index)
    largest = _pieces_of(whole, piece_of_faces(whole) == 0, index)
    if not together or largest.lost < _LOST:
        return largest
    around = surface_around(outward, _AROUND)
    if around is None:
        return largest
    several = _pieces_of(whole, pieces_within(outward, around), index)
    if several.lost > largest.lost - _LOST:
        return largest
    return replace(several, around=around)


def _pieces_of(whole: Mesh, faces: BoolArray, index: IntArray) -> _Pieces:
    """What becomes of the original vertices, (n,), if some faces, (m,), of the whole are kept."""
    kept = is_referenced(replace(whole, faces=whole.faces[faces]))
    has_face = (index >= 0) & is_referenced(whole)[index]
    is_dropped = has_face & ~kept[index]
    stand_in = np.full(len(index), -1)
    stand_in[is_dropped] = stand_ins(
        whole.vertices, kept=np.flatnonzero(kept), dropped=index[is_dropped]
    )
    lost = float((is_dropped & (stand_in < 0)).sum() / max(1, has_face.sum()))
    return _Pieces(faces, np.where(has_face & ~is_dropped, index, -1), stand_in, lost)


def _is_large_hole(finding: Finding) -> bool:
    """Whether a hole is too large to be filled, though smaller ones are."""
    return finding.kind == "holes" and finding.share >= SMALL_HOLE


def _holds_together(mesh: Mesh) -> bool:
    """Whether cutting at non-manifold edges leaves nearly all of the largest piece."""
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
    _, mesh = sound_part(*loose_arrays(source))
    if mesh is None:
        raise InputError("There is no face between finite vertices; a surface is needed.")
    return mesh


def _repaired_points(vertices: npt.NDArray[np.float64]) -> Repaired:
    findings, points = examine_points(vertices)
    diagnosis = Diagnosis(len(vertices), 0, diagonal(points), tuple(findings))
    if len(points) == 0:
        raise InputError("None of its points has three finite coordinates; export it anew.")
    finite = is_finite(vertices)
    _, first, inverse = np.unique(
        vertices[finite] + 0.0, axis=0, return_index=True, return_inverse=True
    )
    order = np.argsort(first)
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    index = np.full(len(vertices), -1, dtype=np.int64)
    index[finite] = rank[inverse.reshape(-1)]
    scale = safe_scale(points)
    original = np.flatnonzero(finite)[first[order]]
    done = frozenset(finding.kind for finding in findings if finding.always_repaired)
    cloud = PointCloud(points / scale)
    none = np.full(len(index), -1)
    return Repaired(cloud, cloud.vertices, index, original, none, diagnosis, done)
