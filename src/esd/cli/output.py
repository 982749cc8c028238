"""What every command has in common: how much it tells, and that it destroys no file."""

from __future__ import annotations

import inspect
import logging
from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import Annotated, Any

import typer

from esd.common import InputError


def free_path(path: Path, *, force: bool) -> Path:
    """The path, if nothing is lost by writing there: no file of any size is, unless forced.

    Raises
    ------
    InputError
        If a file, or a folder with something in it, is there and `force` is not given.
    """
    taken = any(path.iterdir()) if path.is_dir() else path.is_file() and path.stat().st_size > 0
    if taken and not force:
        raise InputError(f"'{path}' exists; choose another name, or give --force to replace it.")
    return path


def tell(message: str) -> None:
    """Print what was done, unless --quiet was given."""
    if not is_quiet():
        typer.echo(message)


def is_quiet() -> bool:
    """Whether --quiet was given."""
    return logging.getLogger().level > logging.WARNING


def telling(function: Callable[..., None]) -> Callable[..., None]:
    """The function of a command with the options --quiet and --verbose added."""

    @wraps(function)
    def command(*arguments: Any, quiet: bool, verbose: bool, **options: Any) -> None:
        if quiet or verbose:
            logging.getLogger().setLevel(logging.ERROR if quiet else logging.INFO)
        function(*arguments, **options)

    own = inspect.signature(function, eval_str=True)
    added = {"quiet": _Quiet, "verbose": _Verbose}
    parameters = [
        inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=False, annotation=kind)
        for name, kind in added.items()
    ]
    whole = own.replace(parameters=[*own.parameters.values(), *parameters])
    command.__signature__ = whole  # type: ignore[attr-defined]
    command.__annotations__ = {name: p.annotation for name, p in whole.parameters.items()}
    return command


_Quiet = Annotated[
    bool, typer.Option("--quiet", "-q", help="Print only errors, and what --json asks for.")
]
_Verbose = Annotated[
    bool, typer.Option("--verbose", "-v", help="Tell what is done, on standard error.")
]
