"""`esd descriptor`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from esd.cli.doctor import tell_findings
from esd.cli.options import ForceOption
from esd.cli.output import about, destination, tell
from esd.cli.progress import progress


def descriptor(
    mesh: Annotated[Path, typer.Argument(metavar="MESH", help="A mesh file.")],
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            metavar="FILE",
            help="Ends in .npy, .npz, .h5 or .csv; by default MESH-KIND.npz.",
        ),
    ] = None,
    kind: Annotated[str, typer.Option(help="{descriptors}.")] = "hks",
    log: Annotated[bool, typer.Option(help="Take the logarithm.")] = False,
    force: ForceOption = False,
) -> None:
    """Write a spectral descriptor of each vertex of MESH, one row a vertex, for unit area.

    MESH may be broken, or points alone: see esd doctor. Vertices that were left out have nan.
    """
    from esd.descriptors.files import check_descriptor_path, save_descriptor
    from esd.descriptors.recipe import descriptors, single_recipe
    from esd.mesh.repair.repair import repair
    from esd.spectral.cache import default_cache

    path = check_descriptor_path(output or Path(f"{mesh.stem}-{kind}.npz"))
    destination(path, force=force, inputs=[mesh])
    recipe = single_recipe(kind, log=log)
    with about(mesh), progress("computing"):
        repaired = repair(mesh)
        values = descriptors(recipe, repaired.shape, cache=default_cache())
    values = repaired.carried_back(values)
    tell_findings(mesh, repaired)
    save_descriptor(values, path)
    tell(f"{kind}: {values.shape[0]} vertices, {values.shape[1]} components; {path}")
