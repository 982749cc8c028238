"""A queue of tasks for one worker process: progress, cancelling, and what became of each."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass, replace
from multiprocessing import connection, get_context
from pathlib import Path
from typing import Any, Literal

from esd.common import InputError
from esd.studio.worker import Task, work

_MOST_WAITING = 20_000
_MOST_KEPT = 50  # jobs that ended and are still listed
_DIED = "The process that computed it died, perhaps for lack of memory."

State = Literal["waiting", "running", "done", "failed", "cancelled"]


@dataclass(frozen=True, slots=True)
class Job:
    """A task in the queue.

    Parameters
    ----------
    number
        Names it.
    title
        What it does, for people.
    state, stage, share
        How far it is; the stage in words, and the share that is done, from 0 to 1.
    error
        Why it failed, in one line.
    kept
        File that keeps the task while it waits or runs; whoever hears of the end removes it.
    """

    number: int
    title: str
    task: Task
    state: State = "waiting"
    stage: str = ""
    share: float = 0.0
    error: str = ""
    kept: Path | None = None


class Jobs:
    """A queue, and a process that does its tasks one after the other.

    Parameters
    ----------
    model
        Name of the model that is loaded at once.
    on_end
        Called in another thread with each job that ended, and its result if it is done, before it
        is listed as ended.
    """

    def __init__(
        self, model: str, on_end: Callable[[Job, dict[str, Any] | None], None] = lambda *_: None
    ) -> None:
        self._model = model
        self._on_end = on_end
        self._changed = threading.Condition()
        self._jobs: dict[int, Job] = {}
        self._next = 1
        self._computing = 0  # number of the job that the process works at
        self._closed = False
        self.version = 0
        self._start_worker()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _start_worker(self) -> None:
        context = get_context("spawn")
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(target=work, args=(theirs, self._model), daemon=True)
        self._process.start()
        theirs.close()

    def submit(self, title: str, task: Task, *, kept: Path | None = None) -> Job:
        """Put a task into the queue; one that waits already is not put there twice.

        Parameters
        ----------
        kept
            See `Job`.

        Raises
        ------
        InputError
            If too many are waiting.
        """
        with self._changed:
            waiting = [job for job in self._jobs.values() if job.state == "waiting"]
            for job in waiting:
                if job.task == task:
                    return job
            if len(waiting) >= _MOST_WAITING:
                raise InputError("Too much is waiting to be computed; cancel some of it.")
            job = Job(self._next, title, task, kept=kept)
            self._next += 1
            self._set(job)
            return job

    def list(self) -> tuple[Job, ...]:
        """The jobs that wait or run, and the last of those that ended."""
        with self._changed:
            return tuple(self._jobs.values())

    def cancel(self, number: int) -> None:
        """Take a job from the queue, or end the process that does it.

        Raises
        ------
        InputError
            If there is no such job.
        """
        with self._changed:
            job = self._jobs.get(number)
            if job is None:
                raise InputError(f"There is no job {number}.")
            if job.state in ("waiting", "running"):
                was_waiting = job.state == "waiting"
                self._set(replace(job, state="cancelled", stage=""))
                if self._computing == number:
                    self._process.terminate()
                elif was_waiting:
                    threading.Thread(target=self._on_end, args=(self._jobs[number], None)).start()

    def close(self) -> None:
        """End the process."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
        self._process.terminate()
        self._process.join()
        self._thread.join()

    def touch(self) -> None:
        """Count something else as a change."""
        with self._changed:
            self.version += 1

    def _set(self, job: Job) -> None:
        self._jobs[job.number] = job
        ended = [
            each.number for each in self._jobs.values() if each.state not in ("waiting", "running")
        ]
        for number in ended[:-_MOST_KEPT]:
            del self._jobs[number]
        self.version += 1
        self._changed.notify_all()

    def _run(self) -> None:
        while (job := self._taken()) is not None:
            ended, result = self._done(job)
            with self._changed:
                if self._closed:
                    return
            try:
                self._on_end(ended, result)
            except (InputError, OSError) as error:  # such as a project or a disk that is full
                ended = replace(ended, state="failed", error=str(error))
            self._update(job, state=ended.state, stage="", error=ended.error)

    def _taken(self) -> Job | None:
        """The next job, marked as running; None once the queue is closed."""
        with self._changed:
            while not self._closed:
                for job in self._jobs.values():
                    if job.state == "waiting":
                        job = replace(job, state="running")
                        self._computing = job.number
                        self._set(job)
                        return job
                self._changed.wait()
        return None

    def _done(self, job: Job) -> tuple[Job, dict[str, Any] | None]:
        """Have a job done; the job as it ended, and its result if there is one."""
        try:
            self._pipe.send(job.task)
            while True:
                connection.wait([self._pipe, self._process.sentinel])
                if not self._pipe.poll():
                    raise EOFError
                kind, value = self._pipe.recv()
                with self._changed:
                    if self._is_cancelled(job):
                        raise EOFError  # the process is about to end
                    if kind != "progress":
                        self._computing = 0
                if kind == "progress":
                    stage, share = value
                    self._update(job, stage=stage, share=share)
                elif kind == "failed":
                    return replace(job, state="failed", error=value), None
                else:
                    return replace(job, state="done"), value
        except (EOFError, OSError):  # the process ended: it was cancelled, or died
            self._process.join()
            self._pipe.close()
            with self._changed:
                self._computing = 0
                is_cancelled = self._is_cancelled(job)
                if not self._closed:
                    self._start_worker()
            if is_cancelled:
                return replace(job, state="cancelled"), None
            return replace(job, state="failed", error=_DIED), None

    def _is_cancelled(self, job: Job) -> bool:
        """Whether a job was cancelled, even if it is no longer listed after many others."""
        now = self._jobs.get(job.number)
        return now is None or now.state == "cancelled"

    def _update(self, job: Job, **changes: Any) -> None:
        """Change a job, unless it was cancelled."""
        with self._changed:
            if not self._is_cancelled(job):
                self._set(replace(self._jobs[job.number], **changes))
            self.version += 1
