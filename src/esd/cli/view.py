"""`esd view`."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

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
from esd.cli.shapes import read_map, read_shown

if TYPE_CHECKING:
    from esd.common import FloatArray
    from esd.matching.correspondence import Correspondence
    from esd.mesh.mesh import Mesh, PointCloud


def view(
    source: SourceArgument,
    target: TargetArgument,
    map: MapArgument,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", metavar="PAGE", help="By default SOURCE-TARGET.html."),
    ] = None,
    truth: TruthOption = None,
    points: PointsOption = None,
    up: Annotated[
        str | None,
        typer.Option(help="The axis that points up: x, -x, y, -y, z or -z; guessed by default."),
    ] = None,
    open_page: Annotated[bool, typer.Option("--open", help="Open the page in a browser.")] = False,
    force: ForceOption = False,
) -> None:
    """Write one web page that shows SOURCE and TARGET side by side with their map.

    The page needs no network. Point at a shape to see the match; press ? for its keys.
    """
    from esd.viewing.page import check_page_path
    from esd.viewing.upright import AXES

    path = check_page_path(output or Path(f"{source.stem}-{target.stem}.html"))
    inputs = [source, target, map, *([truth] if truth else []), *(points or ())]
    destination(path, force=force, inputs=inputs)
    if truth and points:
        raise typer.BadParameter("Give --truth or --points, not both.")
    if up is not None and up not in AXES:
        raise typer.BadParameter(f"--up takes one of {', '.join(AXES)}; got '{up}'.")
    with progress("drawing"):
        source_mesh, target_mesh = read_shown(source), read_shown(target)
        counts = {
            "source_count": len(source_mesh.vertices),
            "target_count": len(target_mesh.vertices),
        }
        match = read_map(map, **counts)
        error = true_error(source_mesh, target_mesh, match, truth, points)
        write_page((source, source_mesh), (target, target_mesh), match, path, error=error, up=up)
    tell(f"written to {path}")
    if open_page:
        typer.launch(str(path.resolve()))


def write_page(
    source: tuple[Path, Mesh],
    target: tuple[Path, Mesh],
    match: Correspondence,
    path: Path,
    *,
    error: FloatArray | None = None,
    model: str | None = None,
    up: str | None = None,
) -> None:
    """Write the page of a map between two mesh files."""
    from esd.viewing.page import view as page_of
    from esd.viewing.upright import default_up, usual_up

    up = up or default_up(source[1], usual=usual_up(source[0]))
    # names of files may hold bytes that are no text
    names = {
        key: os.fsencode(file.name).decode("utf-8", errors="replace")
        for key, file in (("source_name", source[0]), ("target_name", target[0]))
    }
    page_of(source[1], target[1], match, error=error, model=model, up=up, **names).save(path)


def true_error(
    source: Mesh | PointCloud,
    target: Mesh | PointCloud,
    match: Correspondence,
    truth: Path | None,
    points: tuple[Path, Path] | None,
) -> FloatArray | None:
    """Geodesic error at each source vertex over √area, (n,), if the truth is given."""
    from esd.common import InputError
    from esd.datasets.folder import read_vts
    from esd.evaluation.errors import true_map, vertex_errors
    from esd.matching.correspondence import load_map
    from esd.mesh.mesh import Mesh

    if not truth and not points:
        return None
    if not isinstance(target, Mesh):
        raise InputError("Errors are measured along the faces of the target; it has none.")
    counts = {"source_count": len(source.vertices), "target_count": len(target.vertices)}
    if truth:
        known = load_map(truth, **counts).target_index
    else:
        assert points is not None
        known = true_map(read_vts(points[0]), read_vts(points[1]), counts["source_count"])
        if known.max() >= counts["target_count"]:
            raise InputError(
                f"'{points[1]}' names vertex {known.max() + 1} (from 1); "
                f"the target has {counts['target_count']}."
            )
    return vertex_errors(target, match.target_index, known)
