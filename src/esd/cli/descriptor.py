"""`esd descriptor`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from esd.cli.doctor import tell_findings


def descriptor(
    mesh: Annotated[Path, typer.Argument(help="A mesh file.")],
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="FILE", help="Ends in .npy, .npz or .csv.")
    ],
    kind: Annotated[str, typer.Option(help="hks, wks, gps or sihks.")] = "hks",
    log: Annotated[bool, typer.Option(help="Take the logarithm.")] = False,
) -> None:
    """Write a spectral descriptor of each vertex of MESH, one row a vertex, for unit area.

    MESH may be broken, or points alone: see esd doctor. Vertices that were left out have nan.
    """
    from esd.descriptors.files import check_descriptor_path, save_descriptor
    from esd.descriptors.recipe import descriptors, single_recipe
    from esd.mesh.doctor import repair
    from esd.spectral.cache import default_cache

    check_descriptor_path(output)
    shape = repair(mesh)
    values = descriptors(single_recipe(kind, log=log), shape.shape, cache=default_cache())
    values = shape.carried_back(values)
    tell_findings(mesh, shape)
    save_descriptor(values, output)
    typer.echo(f"{kind}: {values.shape[0]} vertices, {values.shape[1]} components; {output}")
