"""The command `esd`: its commands, and what becomes of errors."""

from __future__ import annotations

import logging
import os
import signal
import sys
from collections.abc import Callable
from typing import NoReturn

import typer

from esd.cli.atlas import atlas
from esd.cli.batch import batch
from esd.cli.cache import cache
from esd.cli.data import data
from esd.cli.descriptor import descriptor
from esd.cli.doctor import doctor
from esd.cli.evaluate import evaluate
from esd.cli.export import export
from esd.cli.match import match
from esd.cli.model import model
from esd.cli.output import HELP_NAMES, HelpfulCommand, telling
from esd.cli.precompute import precompute
from esd.cli.register import register
from esd.cli.reproduce import reproduce
from esd.cli.spectrum import spectrum
from esd.cli.studio import studio
from esd.cli.train import train
from esd.cli.transfer import transfer
from esd.cli.view import view
from esd.common import InputError, install_hint

_log = logging.getLogger(__name__)

_TERMINATED = 128 + signal.SIGTERM

app = typer.Typer(
    name="esd",
    help="Point-to-point correspondence between deformable 3D shapes.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings=HELP_NAMES,
)
_EXAMPLES: dict[Callable[..., None], tuple[str, ...]] = {
    match: (
        "esd match a.ply b.ply -o map.csv",
        "esd match a.ply b.ply --view",
        "esd match a.ply b.ply --landmarks a.csv b.csv",
    ),
    batch: ("esd batch pairs.csv -o maps",),
    view: (
        "esd view a.ply b.ply map.csv --open",
        "esd view a.ply b.ply map.csv --points a.vts b.vts -o page.html",
    ),
    studio: ("esd studio", "esd studio a.ply b.ply", "esd studio --project studio"),
    transfer: (
        "esd transfer a.ply b.ply map.csv --labels parts.txt -o b-parts.txt",
        "esd transfer a.obj b.ply map.csv --texture -o b-textured.obj",
        "esd transfer a.ply b.ply map.csv --morph 10 -o between/",
    ),
    register: (
        "esd register template.ply scan.ply -o registered.ply",
        "esd register template.obj scan.ply --map map.csv -o registered.obj",
        "esd register template.ply frames -o registered",
    ),
    atlas: (
        "esd atlas FOLDER -o atlas",
        "esd atlas FOLDER -o atlas --template template.ply --landmarks FOLDER/landmarks",
        "esd atlas FOLDER -o atlas --train",
    ),
    export: (
        "esd export a.ply b.ply map.csv -o a-matched.vtp",
        "esd export a.ply b.ply map.csv -o map.vts",
    ),
    precompute: (
        "esd precompute DATASET -o descriptors.h5 --preset paper-hks",
        "esd precompute DATASET -o descriptors.h5 --scheduler tcp://host:8786",
    ),
    train: (
        "esd train bodies --preset paper-hks -o my-model",
        "esd train descriptors.h5 --preset paper-hks -o my-model",
    ),
    evaluate: ("esd evaluate bodies --include 's1[0-3]_p0[0369]'",),
    spectrum: ("esd spectrum a.ply -k 100 -o a.npz",),
    descriptor: ("esd descriptor a.ply --kind wks -o a-wks.npz",),
    doctor: ("esd doctor a.ply --repair repaired.ply",),
    reproduce: ("esd reproduce table1 --data bodies -o paper",),
    cache: ("esd cache --clear",),
}
for command, examples in _EXAMPLES.items():
    lines = "\n\n".join(("Examples:", *examples))
    app.command(epilog=lines, cls=HelpfulCommand)(telling(command))
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
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(_TERMINATED))
    try:
        app(args=expanded(sys.argv[1:]))
    except InputError as error:
        _fail(str(error))
    except ModuleNotFoundError as error:
        extras = {"torch": "train", "matplotlib": "viz", "PIL": "viz", "distributed": "cluster"}
        extras |= {"starlette": "studio", "uvicorn": "studio"}
        extra = extras.get(error.name or "")
        if extra is None:
            _fail_unexpectedly(error)
        _fail(f"This needs {error.name}: {install_hint(extra)}.")
    except OSError as error:
        _fail(str(error))
    except MemoryError:
        _fail("There is not enough memory for this.")
    except KeyboardInterrupt:
        typer.echo("esd: interrupted", err=True)
        raise SystemExit(130) from None
    except SystemExit as ended:
        if ended.code == _TERMINATED:
            # not by way of the interpreter's end: threads that compute could crash there
            logging.shutdown()
            sys.stdout.flush()
            os._exit(_TERMINATED)
        raise
    except Exception as error:
        _fail_unexpectedly(error)


def expanded(arguments: list[str]) -> list[str]:
    """The arguments with `--landmarks A B` written as `--landmarks A --landmarks B`.

    SOURCE and TARGET may follow: the last two of three or four names are these.
    """
    if "--landmarks" not in arguments:
        return arguments
    at = arguments.index("--landmarks") + 1
    end = at
    while end < len(arguments) and not arguments[end].startswith("-"):
        end += 1
    taken = end - at if end - at <= 2 else end - at - 2
    files = arguments[at : at + taken]
    repeated = [part for file in files[1:] for part in ("--landmarks", file)]
    return [*arguments[:at], *files[:1], *repeated, *arguments[at + taken :]]


def _fail_unexpectedly(error: Exception) -> NoReturn:
    """One line for what nobody thought of; --verbose shows where it happened."""
    _log.info("It happened here:", exc_info=error)
    kind = type(error).__name__
    _fail(f"{kind}: {error}. This is a fault of esd; run again with --verbose for a report.")


def _fail(message: str) -> NoReturn:
    typer.echo(f"esd: {' '.join(message.split())}", err=True)
    raise SystemExit(1)
