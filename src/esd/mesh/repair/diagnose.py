"""What is wrong with a mesh or a point cloud."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from esd.common import IntArray
from esd.mesh.convert import MeshLike
from esd.mesh.geometry import face_areas, face_normals, is_referenced, surface_area
from esd.mesh.mesh import Mesh
from esd.mesh.repair.arrays import diagonal, found, is_finite, loose_arrays, safe_scale, sound_part
from esd.mesh.repair.findings import FEW_VERTICES, Diagnosis, Finding
from esd.mesh.repair.joining import collapse_partners, cut_apart, seam_partners
from esd.mesh.repair.pieces import is_ground
from esd.mesh.topology import (
    SLIVER,
    EdgeTable,
    edge_table,
    fan_count,
    is_collapsed,
    is_inward,
    is_repeated,
    patches,
    piece_of_faces,
    quality,
    rims,
    with_flipped,
    without_repeats,
)

_FOLDED = 0.03  # share of the edges; up to half of that is ordinary in toes and ears


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
    vertices, faces = loose_arrays(source)
    if len(faces) == 0:
        findings, patient = examine_points(vertices)
        return Diagnosis(len(vertices), 0, diagonal(patient), tuple(findings))
    return diagnosed(vertices, faces, thorough=thorough)[0]


def diagnosed(
    vertices: npt.NDArray[np.float64], faces: IntArray, *, thorough: bool
) -> tuple[Diagnosis, Mesh | None]:
    """The diagnosis of a mesh, and what can be computed with, see `sound_part`."""
    counts = len(vertices), len(faces)
    findings, mesh = sound_part(vertices, faces)
    if mesh is None:
        return Diagnosis(*counts, 0.0, tuple(findings)), None
    # vertices whose faces were left out are named for that already
    named = faces[((faces >= 0) & (faces < len(vertices))).all(axis=1)]
    used = np.zeros(len(vertices), dtype=bool)
    used[named.ravel()] = True
    findings += found("unreferenced_vertices", is_finite(vertices) & ~used)
    findings += _examine(mesh)
    if thorough:
        findings += _self_intersections(mesh)
    scale = safe_scale(vertices[is_finite(vertices)])
    size = diagonal(mesh.vertices[is_referenced(mesh)]) * scale
    return Diagnosis(*counts, size, tuple(findings)), mesh


def _examine(mesh: Mesh) -> list[Finding]:
    """What is wrong with the surface of a mesh."""
    findings = []
    all_vertices = np.arange(len(mesh.vertices))
    first = seam_partners(mesh)
    findings += found("duplicate_vertices", first != all_vertices)
    collapsed, repeated = is_collapsed(mesh.faces), is_repeated(mesh.faces)
    findings += found("collapsed_faces", collapsed)
    findings += found("duplicate_faces", repeated & ~collapsed)
    if not surface_area(mesh) > 0:
        return [*findings, Finding("flat_meshes", 1, 1.0)]
    # what follows is that of the surface that is computed on
    mesh = replace(mesh, faces=first[mesh.faces])
    first = collapse_partners(mesh)
    findings += found("zero_length_edges", first != all_vertices)
    mesh = replace(mesh, faces=first[mesh.faces])
    if is_collapsed(mesh.faces).all():  # once what rounding separates is joined
        return [*findings, Finding("flat_meshes", 1, 1.0)]
    mesh = without_repeats(mesh)
    findings += found("slivers", quality(mesh) < SLIVER)
    table = edge_table(mesh.faces, len(mesh.vertices))
    for finding in found("non_manifold_edges", table.count > 2):
        findings.append(replace(finding, first=int(table.ends[finding.first or 0, 0])))
    fans = fan_count(mesh.faces, table, len(mesh.vertices))
    touching = found("non_manifold_vertices", fans > 1)
    findings += touching
    flipped, label, non_orientable = patches(mesh.faces, table)
    inner = table.inner_sides()
    alike = table.are_alike(inner)
    if alike.any():
        vertex = int(table.start[inner[alike][0, 0]])
        share = float(alike.sum() / len(table.ends))
        findings.append(Finding("inconsistent_winding", int(alike.sum()), share, vertex))
    if non_orientable.any():
        share = face_areas(mesh)[non_orientable[label]].sum() / max(surface_area(mesh), 1e-300)
        findings.append(Finding("one_sided_pieces", int(non_orientable.sum()), float(share)))
    mesh = with_flipped(mesh, flipped)
    findings += _folded(mesh, table)
    inward = is_inward(mesh, table, label)
    if inward.any():
        findings.append(Finding("inside_out_pieces", int(inward.sum()), float(inward.mean())))
    findings += _holes(mesh, table)
    findings += _pieces(cut_apart(mesh, at_edges=False)[0] if touching else mesh)
    return findings


def _folded(mesh: Mesh, table: EdgeTable) -> list[Finding]:
    """Edges whose two faces turn by more than a right angle."""
    normals = face_normals(mesh)
    inner = table.inner_sides()
    f, g = inner.T // 3
    back = np.einsum("ij,ij->i", normals[f], normals[g]) < 0
    if back.mean() < _FOLDED if len(back) else True:
        return []
    vertex = int(table.start[inner[back][0, 0]])
    return [Finding("folded_edges", int(back.sum()), float(back.mean()), vertex)]


def _holes(mesh: Mesh, table: EdgeTable) -> list[Finding]:
    rim, length = rims(mesh, table)
    if len(length) == 0:
        return []
    root = max(surface_area(mesh) ** 0.5, np.finfo(float).tiny)
    return [Finding("holes", len(length), float(length.max() / root), int(rim[0, 0]))]


def _pieces(mesh: Mesh) -> list[Finding]:
    findings = []
    ground = is_ground(mesh)
    if ground.any():
        share = float(face_areas(mesh)[ground].sum() / surface_area(mesh))
        findings.append(Finding("ground_planes", 1, share, int(mesh.faces[ground][0, 0])))
        mesh = replace(mesh, faces=mesh.faces[~ground])
    label = piece_of_faces(mesh)
    area = np.bincount(label, weights=face_areas(mesh))
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


def examine_points(
    vertices: npt.NDArray[np.float64],
) -> tuple[list[Finding], npt.NDArray[np.float64]]:
    """What is wrong with points, and those that are finite, once each, in their order."""
    finite = is_finite(vertices)
    findings = found("non_finite_vertices", ~finite)
    points = vertices[finite] + 0.0
    _, first = np.unique(points, axis=0, return_index=True)
    repeated = np.ones(len(points), dtype=bool)
    repeated[first] = False
    findings += found("duplicate_vertices", repeated, of=len(vertices))
    if len(first) < FEW_VERTICES:
        findings.append(Finding("few_vertices", 1, 1 - len(first) / FEW_VERTICES))
    return findings, points[np.sort(first)]
