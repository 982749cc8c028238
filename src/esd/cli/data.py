"""`esd data`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from esd.cli.output import ForceOption, free_path, tell, telling

data = typer.Typer(help="The data sets that ship with the package.", no_args_is_help=True)


@data.command()
@telling
def bodies(
    export: Annotated[Path, typer.Option(metavar="DIR", help="Folder to write.")],
    remeshed: Annotated[
        bool,
        typer.Option(help="Each shape with a triangulation of its own, or all with one."),
    ] = True,
    include: Annotated[
        str | None, typer.Option(metavar="GLOB", help="Only shapes with such names.")
    ] = None,
    force: ForceOption = False,
) -> None:
    """Write the human bodies: shapes/, corres/ and parts/, in the folder layout that esd reads."""
    from esd.datasets.bodies import PARTS, part_labels
    from esd.datasets.bodies import bodies as all_bodies
    from esd.datasets.export import export_folder

    free_path(export / "shapes", force=force)
    collection = all_bodies(remeshed=remeshed)
    if include:
        collection = collection.including(include)
    export_folder(collection, export, part_names=PARTS, part_labels=part_labels())
    tell(f"{len(collection.shapes)} bodies written to {export}")
