"""What every command has in common: how much it prints, and that it destroys no file."""

from __future__ import annotations

import inspect
import logging
import os
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from functools import wraps
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperCommand

from esd.common import InputError, check_can_be_made

HELP_NAMES = {"help_option_names": ["-h", "--help"]}
"""Settings of every command and group of commands."""


def destination(
    path: Path, *, force: bool, inputs: Iterable[Path | str] = (), is_folder: bool = False
) -> Path:
    """The path, if nothing is lost by writing there, which is checked before any work.

    Parameters
    ----------
    force
        Whether a file that exists is replaced.
    inputs
        Files and folders that the command reads; none of them is ever written to, whatever it is
        called there: by another path, or by a link.
    is_folder
        Whether a folder is written.

    Raises
    ------
    InputError
        If an input is there, or its folder cannot be made, or a file that is not empty or a folder
        that is not empty is there and `force` is not given.
    """
    if any(_is_same(path, Path(each)) for each in inputs):
        raise InputError(f"'{path}' is read by this command; choose another name to write to.")
    if path.is_dir() and not is_folder:
        raise InputError(f"'{path}' is a folder; give the name of a file to write.")
    if path.is_file() and is_folder:
        raise InputError(f"'{path}' is a file; give the name of a folder to write.")
    taken = any(path.iterdir()) if path.is_dir() else path.is_file() and path.stat().st_size > 0
    if taken and not force:
        raise InputError(f"'{path}' exists; choose another name, or give --force to replace it.")
    return check_can_be_made(path)


def _is_same(path: Path, other: Path) -> bool:
    try:
        return path.samefile(other)  # hard links are one file, too
    except OSError:  # at least one does not exist
        return os.path.realpath(path) == os.path.realpath(other)


@contextmanager
def about(path: object) -> Iterator[None]:
    """Name a file in errors about its content that do not name it themselves."""
    try:
        yield
    except InputError as error:
        if str(path) in str(error):
            raise
        raise InputError(f"'{path}': {error}") from error


def tell(message: str) -> None:
    """Print what was done, unless --quiet was given."""
    if not is_quiet():
        typer.echo(message)


def is_quiet() -> bool:
    """Whether --quiet was given."""
    return logging.getLogger().level > logging.WARNING


class HelpfulCommand(TyperCommand):
    """A command whose help names what the package holds, looked up when it is shown.

    `{models}`, `{presets}` and `{descriptors}` stand for names in the help of its arguments and
    options.
    """

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Fill in the names, then write the help."""
        for parameter in self.params:
            text = getattr(parameter, "help", None)
            if text and "{" in text:
                parameter.help = text.format_map(_Names())  # type: ignore[attr-defined]
        super().format_help(ctx, formatter)


class _Names(dict[str, str]):
    """Lists of names, imported when they are asked for: they take a second."""

    def __missing__(self, what: str) -> str:
        from esd.descriptors.recipe import DESCRIPTOR_KINDS
        from esd.learning.model import ALIASES, bundled_models
        from esd.learning.presets import PRESETS

        names = {
            "models": (*ALIASES, *bundled_models()),
            "descriptors": tuple(DESCRIPTOR_KINDS),
            "presets": tuple(PRESETS),
        }[what]
        return ", ".join(names)


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
    bool, typer.Option("--verbose", "-v", help="Say what is done, on standard error.")
]
