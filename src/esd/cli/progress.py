"""Progress on standard error: a bar on a terminal, elsewhere a line every ten seconds."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

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
        How many things there are to do; None where they cannot be counted. Of none, nothing is
        shown.
    """
    if is_quiet() or total == 0:
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


@dataclass(eq=False)
class _Count:
    """How many of a number of things are done."""

    total: int | None
    done: int = 0


_counts: list[_Count] = []  # of the steps of a command, of which one after the other is done


@contextmanager
def _lines(what: str, total: int | None) -> Iterator[Callable[[int], None]]:
    count, ended = _Count(total), threading.Event()
    start = time.monotonic()

    def advance(more: int) -> None:
        count.done += more

    def report() -> None:
        nonlocal start
        while not ended.wait(SILENCE):
            unfinished = (each for each in _counts if each.total is None or each.done < each.total)
            if next(unfinished, count) is not count:
                start = time.monotonic()  # its turn has not come
                continue
            _report(what, count, time.monotonic() - start)

    thread = threading.Thread(target=report, daemon=True)
    _counts.append(count)
    thread.start()
    try:
        yield advance
    finally:
        ended.set()
        thread.join()
        _counts.remove(count)


def _report(what: str, count: _Count, seconds: float) -> None:
    number = left = ""
    if count.total:
        number = f" {count.done} of {count.total},"
    if count.total and count.done:
        left = f", about {seconds * (count.total - count.done) / count.done:.0f} s left"
    print(f"esd: {what}:{number} {seconds:.0f} s{left}", file=sys.stderr, flush=True)
