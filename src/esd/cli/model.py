"""`esd model`."""

from __future__ import annotations

from typing import Annotated

import typer

model = typer.Typer(help="The models at hand.", no_args_is_help=True)


@model.command("list")
def list_models() -> None:
    """List the bundled models and the raw descriptors; `default` is paper-hks."""
    from esd.descriptors.recipe import DESCRIPTOR_KINDS
    from esd.learning.model import bundled_models

    for name in bundled_models():
        typer.echo(name)
    for name in DESCRIPTOR_KINDS:
        typer.echo(f"{name} (raw descriptor)")


@model.command()
def show(
    name: Annotated[str, typer.Argument(metavar="MODEL", help="A folder or a name.")],
) -> None:
    """Print what a model is made of and how it was trained."""
    from esd.learning.model import load_model, model_description

    typer.echo(model_description(load_model(name)), nl=False)
