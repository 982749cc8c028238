"""`esd model`."""

from __future__ import annotations

from typing import Annotated

import typer

from esd.cli.output import HELP_NAMES

model = typer.Typer(help="The models at hand.", no_args_is_help=True, context_settings=HELP_NAMES)


@model.command("list")
def list_models() -> None:
    """List the bundled models and the raw descriptors."""
    from esd.descriptors.recipe import DESCRIPTOR_KINDS
    from esd.learning.model import ALIASES, bundled_models

    for name in bundled_models():
        called = "".join(f" ({alias})" for alias, of in ALIASES.items() if of == name)
        typer.echo(f"{name}{called}")
    for name in DESCRIPTOR_KINDS:
        typer.echo(f"{name} (raw descriptor)")


@model.command()
def show(
    name: Annotated[str, typer.Argument(metavar="MODEL", help="A folder or a name.")],
) -> None:
    """Print what a model is made of and how it was trained."""
    from esd.learning.model import load_model, model_description

    typer.echo(model_description(load_model(name)), nl=False)
