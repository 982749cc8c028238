"""`esd export`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from esd.cli.options import (
    ForceOption,
    MapArgument,
    PointsOption,
    SourceArgument,
    TargetArgument,
    TruthOption,
)
from esd.cli.output import free_path, tell
from esd.cli.view import true_error


def export(
    source: SourceArgument,
    target: TargetArgument,
    map: MapArgument,
    output: Annotated[
        Path,
        typer.Option(
            "--output",
            "-o",
            metavar="FILE",
            help="SOURCE with its matches: .ply or .vtp; the map alone: .csv, .npy, .txt or .vts.",
        ),
    ],
    truth: TruthOption = None,
    points: PointsOption = None,
    force: ForceOption = False,
) -> None:
    """Write SOURCE with its matches as attributes of its vertices, or MAP in another format.

    PLY opens in MeshLab and Blender, VTP in ParaView.
    """
    from esd.matching.correspondence import load_map, save_map
    from esd.mesh.convert import as_mesh
    from esd.mesh.io.attributes import ATTRIBUTE_FORMATS, write_with_attributes

    free_path(output, force=force)
    source_mesh, target_mesh = as_mesh(source), as_mesh(target)
    match = load_map(
        map, source_count=len(source_mesh.vertices), target_count=len(target_mesh.vertices)
    )
    if output.suffix.lower() in ATTRIBUTE_FORMATS:
        attributes = match.attributes()
        error = true_error(source_mesh, target_mesh, match, truth, points)
        if error is not None:
            attributes["error"] = error
        write_with_attributes(source_mesh, attributes, output)
    else:
        save_map(match, output)
    tell(f"written to {output}")
