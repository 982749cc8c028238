"""Independent jobs: two in threads, many on all cores or on a Dask cluster."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterable, Iterator
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
from itertools import islice
from multiprocessing import get_context, parent_process
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Generic, TypeVar

from threadpoolctl import ThreadpoolController, threadpool_limits

from esd.common import InputError

_DIED = "the process that computed it died, perhaps for lack of memory"
_QUEUED = 2  # jobs handed out for each worker: one at work, one that waits

Job = TypeVar("Job")
Result = TypeVar("Result")


@dataclass(frozen=True, slots=True, eq=False)
class Outcome(Generic[Job, Result]):
    """What became of a job: its result, or in words why there is none."""

    job: Job
    result: Result | None = None
    failure: str | None = None

    def told_of(self, name: object) -> str:
        """The failure, with the name of what failed where it does not tell that itself."""
        said = self.failure or ""
        return said if f"'{name}'" in said else f"'{name}': {said}"


def outcomes(
    function: Callable[[Job], Result],
    jobs: Iterable[Job],
    *,
    workers: int | None = None,
    scheduler: str | None = None,
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
        Number of processes; by default one for each core. With one, this process computes.
    scheduler
        Address of a Dask scheduler, such as `tcp://host:8786`, whose workers compute instead.

    Raises
    ------
    InputError
        If `workers` is not positive, or no scheduler answers.
    """
    if workers is not None and workers < 1:
        raise InputError(f"`workers` must be at least 1; got {workers}.")
    if scheduler is not None:
        with _dask(scheduler) as (executor, count):
            yield from _handed_out(function, iter(jobs), executor, count)
        return
    processes = core_count() if workers is None else workers
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
def shared_folder(scheduler: str | None = None) -> Iterator[Path]:
    """A temporary folder that the workers see: within the current one if a scheduler has them."""
    here = None if scheduler is None else Path.cwd()
    with TemporaryDirectory(prefix=".esd-", dir=here) as name:
        yield Path(name)


def core_count() -> int:
    """Number of processor cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def blas_libraries() -> ThreadpoolController:
    """The BLAS libraries of this process; to look for them takes a millisecond."""
    return ThreadpoolController().select(user_api="blas")


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
    pool = ProcessPoolExecutor(
        processes, mp_context=get_context("spawn"), initializer=_end_with_parent
    )
    with pool:
        yield from _handed_out(function, jobs, pool, lambda: processes)


@contextmanager
def _dask(scheduler: str) -> Iterator[tuple[Executor, Callable[[], int]]]:
    """An executor on the workers of a scheduler, and how many cores they have now."""
    from distributed import Client

    try:
        client = Client(scheduler, set_as_default=False)
    except (OSError, ValueError) as error:
        raise InputError(
            f"No Dask scheduler answers at '{scheduler}': {error}. Start one by `dask scheduler`."
        ) from error
    with client, client.get_executor() as executor:
        yield executor, lambda: sum(client.ncores().values())


def _handed_out(
    function: Callable[[Job], Result],
    left: Iterator[Job],
    executor: Executor,
    workers: Callable[[], int],
) -> Iterator[Outcome[Job, Result]]:
    """Outcomes by an executor; none of the jobs left is taken once its processes died."""
    running: dict[Future[Outcome[Job, Result]], Job] = {}
    died = False
    try:
        while True:
            free = 0 if died else _QUEUED * max(1, workers()) - len(running)
            try:
                for job in islice(left, max(0, free)):
                    running[executor.submit(_tried, function, job)] = job
            except BrokenExecutor:
                died = True
                yield Outcome(job, failure=_DIED)
            if not running:
                return
            for future in wait(running, return_when=FIRST_COMPLETED).done:
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


def _tried(function: Callable[[Job], Result], job: Job) -> Outcome[Job, Result]:
    try:
        with threadpool_limits(1):
            return Outcome(job, function(job))
    except Exception as error:
        return Outcome(job, failure=_in_words(error))


def _in_words(error: Exception) -> str:
    """The reason of a failure in one line."""
    said = " ".join(str(error).split())
    return said if isinstance(error, InputError) else f"{type(error).__name__}: {said}"


def _end_with_parent() -> None:
    """Let this process end when its parent is killed; it would wait for jobs for ever."""

    def watch() -> None:
        parent = parent_process()
        if parent is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
