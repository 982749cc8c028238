"""The command `esd`: its commands, and what becomes of errors."""

from __future__ import annotations

import logging
import signal
import sys

import typer

from esd.cli.cache import cache
from esd.cli.data import data
from esd.cli.descriptor import descriptor
from esd.cli.doctor import doctor
from esd.cli.evaluate import evaluate
from esd.cli.match import match
from esd.cli.model import model
from esd.cli.reproduce import reproduce
from esd.cli.spectrum import spectrum
from esd.cli.train import train
from esd.common import InputError

app = typer.Typer(
    name="esd",
    help="Point-to-point correspondence between deformable 3D shapes.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
for command in (match, train, evaluate, spectrum, descriptor, doctor, reproduce, cache):
    app.command()(command)
app.add_typer(data, name="data")
app.add_typer(model, name="model")


def _print_version(wanted: bool) -> None:
    if wanted:
        from esd import __version__

        typer.echo(f"esd {__version__}")
        raise typer.Exit


@app.callback()
def _common(
    version: bool = typer.Option(
        False, "--version", help="Print the version.", callback=_print_version, is_eager=True
    ),
) -> None:
    """Point-to-point correspondence between deformable 3D shapes."""


def main() -> None:
    """Run the command line; ends the process with 0, 1 (bad input) or 2 (wrong usage)."""
    logging.basicConfig(format="esd: %(message)s", level=logging.WARNING, stream=sys.stderr)
    # as Ctrl-C does, so that temporary files are removed on the way out
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))
    try:
        app()
    except InputError as error:
        _fail(str(error))
    except ModuleNotFoundError as error:
        extra = {"torch": "train", "matplotlib": "viz"}.get(error.name or "")
        if extra is None:
            raise
        _fail(f"This needs {error.name}: pip install 'esd[{extra}]'.")
    except OSError as error:
        _fail(str(error))
    except MemoryError:
        _fail("There is not enough memory for this.")
    except KeyboardInterrupt:
        typer.echo("esd: interrupted", err=True)
        raise SystemExit(130) from None


def _fail(message: str) -> None:
    typer.echo(f"esd: {' '.join(message.split())}", err=True)
    raise SystemExit(1)
