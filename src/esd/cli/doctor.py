"""`esd doctor`."""

from __future__ import annotations

import json
import logging
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from esd.cli.options import ForceOption
from esd.cli.output import about, destination
from esd.cli.progress import progress

if TYPE_CHECKING:
    from esd.mesh.mesh import Mesh
    from esd.mesh.repair.repair import Repaired


def doctor(
    mesh: Annotated[Path, typer.Argument(metavar="MESH", help="A mesh file, or one of points.")],
    repair: Annotated[
        Path | None,
        typer.Option(
            metavar="OUT",
            help="Write the repaired mesh here, and beside it OUT.map.csv, the repaired vertex of "
            "each vertex of MESH.",
        ),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the findings as JSON.")] = False,
    force: ForceOption = False,
) -> None:
    """Report what is wrong with MESH, how bad it is, what it does to results, what can be done."""
    from esd.common import InputError, install_hint
    from esd.mesh.convert import as_arrays
    from esd.mesh.io.meshes import check_mesh_path, write_mesh
    from esd.mesh.mesh import Mesh
    from esd.mesh.repair.diagnose import can_find_self_intersections, diagnose
    from esd.mesh.repair.repair import repair as repaired

    if repair is not None:
        check_mesh_path(repair)
        map_path = repair.with_name(repair.name + ".map.csv")
        for path in (repair, map_path):
            destination(path, force=force, inputs=[mesh])
    with about(mesh), progress("looking"):
        arrays = as_arrays(mesh)
        diagnosis = diagnose(arrays)
    findings = [
        {
            "kind": finding.kind,
            "what": finding.what,
            "count": finding.count,
            "share": finding.share,
            "first": finding.first,
            "severity": finding.severity,
            "effect": finding.effect,
            "remedy": finding.remedy,
            "always_repaired": finding.always_repaired,
        }
        for finding in diagnosis.findings
    ]
    summary = {
        "mesh": str(mesh),
        "vertices": diagnosis.vertices,
        "faces": diagnosis.faces,
        "size": diagnosis.size,
        "severity": diagnosis.severity,
        "findings": findings,
        "self_intersections_checked": can_find_self_intersections() and diagnosis.faces > 0,
    }
    if not as_json:
        kind = f"{diagnosis.faces} faces" if diagnosis.faces else "no faces: a point cloud"
        typer.echo(
            f"{mesh}: {diagnosis.vertices} vertices, {kind}; size {diagnosis.size:.4g} "
            "(no matter: shapes are scaled to unit area)"
        )
        for finding in findings:
            when = "always" if finding["always_repaired"] else "with --repair"
            typer.echo(f"  {finding['severity']:8}  {finding['what']}")
            typer.echo(f"            {finding['effect']}")
            typer.echo(f"            Remedy, {when}: {finding['remedy']}.")
        if not findings:
            typer.echo("  nothing wrong")
        if not summary["self_intersections_checked"] and diagnosis.faces:
            typer.echo(f"  To find faces that cut through each other: {install_hint('doctor')}.")
    if repair is not None:
        with about(mesh), progress("repairing"):
            done = repaired(arrays, everything=True).compacted()
        if not isinstance(done.shape, Mesh):
            raise InputError("Points cannot be written as a mesh; match takes them as they are.")
        write_mesh(done.shape, repair)
        _save_index_map(done, done.shape, map_path, repair)
        kept = int((done.vertex_index >= 0).sum())
        summary["repaired"] = {
            "mesh": str(repair),
            "map": str(map_path),
            "vertices": len(done.shape.vertices),
            "faces": len(done.shape.faces),
            "carried_over": kept,
        }
        if not as_json:
            typer.echo(
                f"Repaired: {len(done.shape.vertices)} vertices, {kept} of "
                f"{diagnosis.vertices} carried over; {repair}, {map_path}"
            )
    if as_json:
        typer.echo(json.dumps(summary))


def _save_index_map(repaired: Repaired, written: Mesh, path: Path, mesh_path: Path) -> None:
    """Write which vertex became which as a map, which `esd.load_map` reads."""
    import numpy as np

    from esd.matching.correspondence import Correspondence, save_map
    from esd.mesh.io.stl import stl_vertices

    index = repaired.vertex_index
    kept = index >= 0
    if mesh_path.suffix.lower() == ".stl":  # its vertices come back in another order
        index = np.where(kept, stl_vertices(written)[index], -1)
    save_map(Correspondence(index, np.where(kept, 0.0, np.inf), np.where(kept, 1.0, 0.0)), path)


def tell_findings(path: Path, repaired: Repaired) -> None:
    """Say in one line what was wrong with a file, if anything was."""
    if repaired.in_a_line():
        logging.getLogger(__name__).warning("'%s' has %s.", path, repaired.in_a_line())
