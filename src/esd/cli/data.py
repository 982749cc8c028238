"""`esd data`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from esd.cli.options import ForceOption
from esd.cli.output import HELP_NAMES, destination, tell, telling

data = typer.Typer(
    help="The bodies that ship with the package; Dyna and D-FAUST.",
    no_args_is_help=True,
    context_settings=HELP_NAMES,
)


@data.command()
@telling
def bodies(
    export: Annotated[Path, typer.Option(metavar="DIR", help="Folder to write.")] = Path("bodies"),
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
    from esd.cli.progress import progress
    from esd.datasets.bodies import PARTS, part_labels
    from esd.datasets.bodies import bodies as all_bodies
    from esd.datasets.export import export_folder
    from esd.parallel import EVERY_CORE

    for name in ("shapes", "corres", "parts", "subjects.csv"):
        destination(export / name, force=force, is_folder="." not in name)
    collection = all_bodies(remeshed=remeshed)
    if include:
        collection = collection.including(include)
    with progress("writing", len(collection.shapes)) as written:
        export_folder(
            collection,
            export,
            part_names=PARTS,
            part_labels=part_labels(),
            workers=EVERY_CORE,
            on_shape=lambda: written(1),
        )
    tell(f"{len(collection.shapes)} bodies written to {export}")


DynaArgument = Annotated[
    Path, typer.Argument(metavar="DYNA", help="An HDF5 file of Dyna or D-FAUST, or their folder.")
]


@data.command("list")
@telling
def list_recordings(path: DynaArgument) -> None:
    """List the sequences of Dyna or D-FAUST: subject, sequence and number of frames."""
    from esd.datasets.dyna import recordings

    for found in recordings(path):
        typer.echo(f"{found.subject}\t{found.sequence}\t{len(found.frames)}")


@data.command()
@telling
def select(
    path: DynaArgument,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output", "-o", metavar="FILE", help="By default named as DYNA: NAME-selection.hdf5."
        ),
    ] = None,
    per_subject: Annotated[int, typer.Option(min=1, help="Frames of each subject.")] = 10,
    seed: Annotated[int, typer.Option(min=0, help="Of the draw.")] = 0,
    force: ForceOption = False,
) -> None:
    """Write some frames of each subject of Dyna or D-FAUST to a small file, to work with."""
    from esd.cli.progress import progress
    from esd.datasets.dyna import save_selection

    output = output or Path(f"{path.stem}-selection.hdf5")
    destination(output, force=force, inputs=[path, *(path.glob("*") if path.is_dir() else ())])
    with progress("selecting"):
        count = save_selection(path, output, per_subject=per_subject, seed=seed)
    tell(f"{count} frames written to {output}")
