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
from esd.cli.output import destination, tell
from esd.cli.progress import progress
from esd.cli.shapes import read_shape
from esd.cli.view import true_error


def export(
    source: SourceArgument,
    target: TargetArgument,
    map: MapArgument,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            metavar="FILE",
            help="SOURCE with its matches: .ply or .vtp; the map alone: .csv, .npy, .txt or .vts. "
            "By default SOURCE-TARGET.ply.",
        ),
    ] = None,
    truth: TruthOption = None,
    points: PointsOption = None,
    force: ForceOption = False,
) -> None:
    """Write SOURCE with its matches as attributes of its vertices, or MAP in another format.

    PLY opens in MeshLab and Blender, VTP in ParaView.
    """
    from esd.common import InputError
    from esd.matching.correspondence import MAP_SUFFIXES, load_map, save_map
    from esd.mesh.io.attributes import ATTRIBUTE_FORMATS, write_with_attributes

    path = output or Path(f"{source.stem}-{target.stem}.ply")
    if path.suffix.lower() not in ATTRIBUTE_FORMATS + MAP_SUFFIXES:
        raise InputError(
            f"'{path}': expected {', '.join(ATTRIBUTE_FORMATS)} for SOURCE with its matches, or "
            f"{', '.join(MAP_SUFFIXES)} for the map alone."
        )
    if truth and points:
        raise typer.BadParameter("Give --truth or --points, not both.")
    inputs = [source, target, map, *([truth] if truth else []), *(points or ())]
    destination(path, force=force, inputs=inputs)
    with progress("writing"):
        shapes = read_shape(source), read_shape(target)
        match = load_map(
            map, source_count=len(shapes[0].vertices), target_count=len(shapes[1].vertices)
        )
        if path.suffix.lower() in ATTRIBUTE_FORMATS:
            attributes = match.attributes()
            error = true_error(*shapes, match, truth, points)
            if error is not None:
                attributes["error"] = error
            write_with_attributes(shapes[0], attributes, path)
        else:
            save_map(match, path)
    tell(f"written to {path}")
