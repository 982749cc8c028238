"""`esd studio`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from esd.cli.output import tell


def studio(
    shapes: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="[MESH]...",
            help="Mesh files to start with; two are matched.",
            show_default=False,
        ),
    ] = None,
    project: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Folder of the project, new or one to resume; by default a new one here.",
            show_default=False,
        ),
    ] = None,
    port: Annotated[
        int, typer.Option(min=0, max=65535, help="Where to listen; 0: any free port.")
    ] = 0,
    browser: Annotated[
        bool, typer.Option("--browser/--no-browser", help="Open the page in a browser.")
    ] = True,
) -> None:
    """Match shapes in the browser: look at maps, correct them with landmarks, export them.

    Nothing leaves this machine. All that happens is kept in the project folder.
    """
    from esd.studio.serve import new_project_folder, serve

    folder = new_project_folder(Path.cwd()) if project is None else project

    def started(address: str) -> None:
        tell(f"The studio is at {address}")
        tell(f"Everything is kept in '{folder}'. Press Ctrl-C to end; give --project to resume.")
        if browser:
            typer.launch(address)

    serve(folder, shapes=shapes or (), port=port, on_start=started)
