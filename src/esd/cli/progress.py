"""Progress on standard error: a bar on a terminal, elsewhere a line every ten seconds."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from esd.cli.output import is_quiet

SILENCE = 10.0
"""Seconds between two lines where standard error is no terminal."""


@contextmanager
def progress(what: str, total: int | None = None) -> Iterator[Callable[[int], None]]:
    """A function to be called with the number of things done since the last call.

    Parameters
    ----------
    what
        What is done, such as `matching`.
    total
        How many things there are to do; None where they cannot be counted.
    """
    if is_quiet():
        yield lambda _: None
    elif sys.stderr.isatty():
        with _bar(what, total) as advance:
            yield advance
    else:
        with _lines(what, total) as advance:
            yield advance


@contextmanager
def _bar(what: str, total: int | None) -> Iterator[Callable[[int], None]]:
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        ProgressColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    columns: tuple[str | ProgressColumn, ...] = ("{task.description}", BarColumn())
    columns += (MofNCompleteColumn(), TimeRemainingColumn()) if total else (TimeElapsedColumn(),)
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(what, total=total)
        yield lambda count: bar.advance(task, count)


@contextmanager
def _lines(what: str, total: int | None) -> Iterator[Callable[[int], None]]:
    start, done, ended = time.monotonic(), 0, threading.Event()

    def advance(count: int) -> None:
        nonlocal done
        done += count

    def report() -> None:
        while not ended.wait(SILENCE):
            count = f" {done} of {total}," if total else ""
            seconds = time.monotonic() - start
            print(f"esd: {what}:{count} {seconds:.0f} s", file=sys.stderr, flush=True)

    thread = threading.Thread(target=report, daemon=True)
    thread.start()
    try:
        yield advance
    finally:
        ended.set()
        thread.join()
