"""`esd data`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

data = typer.Typer(help="The data sets that ship with the package.", no_args_is_help=True)


@data.command()
def bodies(
    export: Annotated[Path, typer.Option(metavar="DIR", help="Folder to write.")],
    remeshed: Annotated[
        bool,
        typer.Option(help="Each shape with a triangulation of its own, or all with one."),
    ] = True,
    include: Annotated[
        str | None, typer.Option(metavar="GLOB", help="Only shapes with such names.")
    ] = None,
) -> None:
    """Write the human bodies: shapes/, corres/ and parts/, in the folder layout that esd reads."""
    from esd.datasets.bodies import PARTS, part_labels
    from esd.datasets.bodies import bodies as all_bodies
    from esd.datasets.export import export_folder

    collection = all_bodies(remeshed=remeshed)
    if include:
        collection = collection.including(include)
    export_folder(collection, export, part_names=PARTS, part_labels=part_labels())
    typer.echo(f"{len(collection.shapes)} bodies written to {export}")
