"""Independent jobs: two in threads, many on all cores or on a Dask cluster."""

from __future__ import annotations

import asyncio
import logging
import math
import os
import re
import shutil
import signal
import sys
import threading
import time
from collections.abc import Callable, Coroutine, Iterable, Iterator
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    Executor,
    Future,
    ProcessPoolExecutor,
    ThreadPoolExecutor,
    wait,
)
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache, partial
from itertools import islice
from multiprocessing import connection, get_context, parent_process
from multiprocessing.connection import Connection
from pathlib import Path
from socket import gethostname
from tempfile import TemporaryDirectory, gettempdir
from typing import Any, Generic, TypeVar

from threadpoolctl import ThreadpoolController

from esd.common import InputError

_log = logging.getLogger(__name__)
_not_in_job = threading.Lock()  # in a process of a pool: held from the end of a job to the next

_ADDRESS = r"((tcp|tls|ucx|ws|wss)://)?(\[[0-9a-fA-F:]+\]|[^\s/:]+):\d{1,5}"
_SILENCE = 10  # seconds without workers after which this is said
_DIED = "the process that computed it died, perhaps for lack of memory"
_GLANCE = 0.1  # seconds between two looks whether the parent runs
_QUEUED = 2  # jobs handed out for each worker: one at work, one that waits

Job = TypeVar("Job")
Result = TypeVar("Result")


@dataclass(frozen=True, slots=True, eq=False)
class Outcome(Generic[Job, Result]):
    """What became of a job: its result, or in words why there is none."""

    job: Job
    result: Result | None = None
    failure: str | None = None

    def failure_of(self, name: object) -> str:
        """The failure, with the name of what failed where it does not name that itself."""
        said = self.failure or ""
        return said if f"'{name}'" in said else f"'{name}': {said}"


@dataclass(frozen=True, slots=True)
class Workers:
    """What computes independent jobs: processes of this machine, or a Dask cluster.

    Parameters
    ----------
    processes
        Number of processes; by default one for each core. With one, this process computes.
    scheduler
        Address of a Dask scheduler, such as `tcp://host:8786`, whose workers compute instead.
    patience
        Seconds that are waited for the scheduler, and for its workers while it has none.

    Raises
    ------
    InputError
        If both are given, the number or the time is not positive, or the address is none.
    """

    processes: int | None = None
    scheduler: str | None = None
    patience: float = 60.0

    def __post_init__(self) -> None:
        if self.processes is not None and self.scheduler is not None:
            raise InputError("Give a number of processes or a scheduler, not both.")
        if self.processes is not None and self.processes < 1:
            raise InputError(f"`processes` must be at least 1; got {self.processes}.")
        if not self.patience > 0:
            raise InputError(f"`patience` must be a positive number of seconds: {self.patience}.")
        if self.scheduler is not None and not re.fullmatch(_ADDRESS, self.scheduler):
            raise InputError(
                f"'{self.scheduler}' is not the address of a Dask scheduler; expected one such as "
                "tcp://host:8786, which `dask scheduler` prints when it starts."
            )


EVERY_CORE = Workers()
"""A process for each core."""

THIS_PROCESS = Workers(1)
"""This process alone."""


def outcomes(
    function: Callable[[Job], Result],
    jobs: Iterable[Job],
    *,
    workers: Workers = EVERY_CORE,
) -> Iterator[Outcome[Job, Result]]:
    """Outcomes of jobs, in the order in which they are done; none keeps the others from theirs.

    Only some jobs are handed out at a time, so memory does not grow with their number, and each
    computes in one thread. When a process dies, the jobs it may have died of are tried once more,
    each alone.

    Parameters
    ----------
    function
        Of one job. Both go to other processes: a function of a module, plain data.
    workers
        What computes.

    Raises
    ------
    InputError
        If no scheduler answers, or it has no workers for longer than the patience.
    """
    if workers.scheduler is not None:
        with _dask(workers) as (executor, count):
            yield from _handed_out(function, iter(jobs), executor, count, patience=workers.patience)
        return
    processes = core_count() if workers.processes is None else workers.processes
    if processes == 1:
        yield from (_tried(function, job) for job in jobs)
        return
    left, suspects = iter(jobs), True
    while suspects:
        suspects = False
        for outcome in _pooled(function, left, processes):
            if outcome.failure != _DIED:
                yield outcome
                continue
            suspects = True
            yield from _pooled(function, iter([outcome.job]), 1)


@contextmanager
def shared_folder(workers: Workers = EVERY_CORE) -> Iterator[Path]:
    """A temporary folder that the workers see: within the current one if a scheduler has them.

    Folders that processes left there which were killed are removed.
    """
    base = Path(gettempdir()) if workers.scheduler is None else Path.cwd()
    host = re.sub(r"\W", "", gethostname())
    for old in base.glob(f".esd-{host}-*-*"):
        number = old.name.split("-")[2]
        if number.isdigit() and not _is_running(int(number)):
            shutil.rmtree(old, ignore_errors=True)
    with TemporaryDirectory(prefix=f".esd-{host}-{os.getpid()}-", dir=base) as name:
        yield Path(name)


def _is_running(process: int) -> bool:
    """Whether there is such a process on this machine; on Windows it is supposed."""
    if sys.platform == "win32":  # where os.kill would end it
        return True
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:
        return True
    return True


def core_count() -> int:
    """Number of processor cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def blas_libraries() -> ThreadpoolController:
    """The BLAS libraries of this process."""
    return _libraries(len(sys.modules)).select(user_api="blas")


@lru_cache(maxsize=1)
def _libraries(modules: int) -> ThreadpoolController:
    """All libraries with threads of their own; others come with other modules only.

    To look for them takes two milliseconds, as long as matching two small shapes.
    """
    return ThreadpoolController()


def thread_count(blas: ThreadpoolController) -> int:
    """Number of threads that computations here may take: no more than the BLAS library's own."""
    return min([core_count()] + [library["num_threads"] for library in blas.info()])


def side_by_side(function: Callable[[Job], Result], jobs: Iterable[Job]) -> list[Result]:
    """Results of a few jobs, each in a thread of its own, if threads may be taken.

    Meanwhile the BLAS library is held to one thread: where most time goes into small products and
    sparse factors, two jobs in one thread each are done sooner than one after the other in two.
    """
    blas = blas_libraries()
    count = thread_count(blas)
    if count == 1:
        return [function(job) for job in jobs]
    with blas.limit(limits=1), ThreadPoolExecutor(count) as pool:
        return list(pool.map(function, jobs))


def _pooled(
    function: Callable[[Job], Result], jobs: Iterator[Job], processes: int
) -> Iterator[Outcome[Job, Result]]:
    # spawned, because forking a process that runs threads can hang
    context = get_context("spawn")
    ended, end = context.Pipe(duplex=False)
    root = logging.getLogger()
    formatters = [each.formatter for each in root.handlers if each.formatter]
    form = formatters[0]._fmt if formatters else None
    pool = ProcessPoolExecutor(
        processes,
        mp_context=context,
        initializer=_start,
        initargs=(ended, root.level, form),
    )
    try:
        yield from _handed_out(partial(_endable, function), jobs, pool, lambda: processes)
    except BaseException:
        end.close()  # which ends the processes at once: jobs that are queued would run on
        raise
    finally:
        pool.shutdown(cancel_futures=True)
        end.close()
        ended.close()


@contextmanager
def _dask(workers: Workers) -> Iterator[tuple[Executor, Callable[[], int]]]:
    """An executor on the workers of a scheduler, and how many cores they have now."""
    from distributed import Client

    _await_scheduler(workers)
    with Client(workers.scheduler, set_as_default=False, timeout=workers.patience) as client:
        _warn_of_versions(client)
        with client.get_executor() as executor:
            yield executor, lambda: sum(client.ncores().values())


def _await_scheduler(workers: Workers) -> None:
    """Return once a scheduler has answered; a client would not end in order if none did."""
    from distributed.core import rpc

    async def identity() -> Any:
        async with rpc(workers.scheduler, timeout=workers.patience) as scheduler:
            return await asyncio.wait_for(scheduler.identity(), workers.patience)

    report = threading.Timer(
        _SILENCE, _log.warning, ["No scheduler has answered at '%s' yet.", workers.scheduler]
    )
    report.daemon = True
    report.start()
    try:
        if _awaited(identity).get("type") == "Scheduler":
            return
    except (OSError, TimeoutError, asyncio.TimeoutError) as error:  # two in Python 3.10
        raise InputError(
            f"No Dask scheduler answered at '{workers.scheduler}' within {workers.patience:g} s. "
            "Start one by `dask scheduler`, and give the address that it prints."
        ) from error
    except Exception as error:  # distributed fails in many ways on what it cannot read
        _log.info("What answered cannot be read: %s: %s", type(error).__name__, error)
    finally:
        report.cancel()
    raise InputError(
        f"What answers at '{workers.scheduler}' is no Dask scheduler, or one of a version that "
        "cannot be read here. Give the address that `dask scheduler` prints."
    )


def _awaited(function: Callable[[], Coroutine[Any, Any, Any]]) -> Any:
    """What a coroutine returns; also where an event loop is running, as in notebooks."""
    try:
        asyncio.get_running_loop()
    except RuntimeError:
        return asyncio.run(function())
    with ThreadPoolExecutor(1) as executor:  # an event loop of its own
        return executor.submit(lambda: asyncio.run(function())).result()


def _warn_of_versions(client: Any) -> None:
    """Say in the log which workers have another Python or Dask, which may not read our jobs."""
    found = client.get_versions()
    own = {key: found["client"]["packages"].get(key) for key in ("python", "distributed")}
    for address, worker in found["workers"].items():
        theirs = {key: worker["packages"].get(key) for key in own}
        if theirs != own:
            _log.warning("The worker %s has %s; here it is %s.", address, theirs, own)


def _handed_out(
    function: Callable[[Job], Result],
    left: Iterator[Job],
    executor: Executor,
    workers: Callable[[], int],
    *,
    patience: float = math.inf,
) -> Iterator[Outcome[Job, Result]]:
    """Outcomes by an executor; none of the jobs left is taken once its processes died."""
    running: dict[Future[Outcome[Job, Result]], Job] = {}
    died = False
    alone_since, is_reported = math.inf, False  # since when there are no workers
    try:
        while True:
            count = workers()
            free = 0 if died else _QUEUED * max(1, count) - len(running)
            try:
                for job in islice(left, max(0, free)):
                    with _no_interrupt():
                        running[executor.submit(_tried, function, job)] = job
            except BrokenExecutor:
                died = True
                yield Outcome(job, failure=_DIED)
            if not running:
                return
            now = time.monotonic()
            alone_since = math.inf if count else min(alone_since, now)
            if now - alone_since > min(_SILENCE, patience) and not is_reported:
                is_reported = True
                _log.warning("The scheduler has no workers yet; waiting for some.")
            if now - alone_since > patience:
                raise InputError(
                    f"The scheduler has had no workers for {patience:g} s. Start some by `dask "
                    "worker ADDRESS`, or wait longer with --patience SECONDS."
                )
            timeout = None if patience == math.inf else min(1.0, patience)
            for future in wait(running, timeout, return_when=FIRST_COMPLETED).done:
                job = running.pop(future)
                try:
                    yield future.result()
                except BrokenExecutor:
                    died = True
                    yield Outcome(job, failure=_DIED)
                except Exception as error:
                    yield Outcome(job, failure=_in_words(error))
    finally:
        for future in running:
            future.cancel()


@contextmanager
def _no_interrupt() -> Iterator[None]:
    """Keep Ctrl-C from processes that start meanwhile: a terminal sends it to all of them.

    They inherit the mask of signals of this thread, which it gets back.
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _tried(function: Callable[[Job], Result], job: Job) -> Outcome[Job, Result]:
    try:
        with _libraries(len(sys.modules)).limit(limits=1):
            return Outcome(job, function(job))
    except Exception as error:
        return Outcome(job, failure=_in_words(error))


def _in_words(error: Exception) -> str:
    """The reason of a failure in one line."""
    said = " ".join(str(error).split())
    return said if isinstance(error, InputError) else f"{type(error).__name__}: {said}"


def _start(ended: Connection, level: int, form: str | None) -> None:
    """Let a new process end with its parent, and log what it logs in the same form."""
    _end_with_parent(ended)
    logging.basicConfig(level=level, format=form or "%(message)s")


def _endable(function: Callable[[Job], Result], job: Job) -> Result:
    """The result of a job in a process of a pool, which may be ended meanwhile."""
    _not_in_job.release()
    try:
        return function(job)
    finally:
        _not_in_job.acquire()


def _end_with_parent(ended: Connection) -> None:
    """Let this process end when its parent is killed, or closes the other end of a pipe.

    It would wait for jobs for ever, or finish those that are queued. As long as the parent runs, it
    ends only within a job: a result that is broken off would block the parent for ever.
    """
    _not_in_job.acquire()

    def watch() -> None:
        parent = parent_process()
        if parent is None:
            return
        connection.wait([parent.sentinel, ended])
        while not _not_in_job.acquire(timeout=_GLANCE):
            if connection.wait([parent.sentinel], 0):
                break
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
