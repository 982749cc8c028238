"""Memory of a Dask scheduler while `esd` hands out many jobs that do nothing.

    python benchmarks/scheduler.py --jobs 5000

A scheduler and one worker are started as a user would. Each job carries the default model, as those
of `esd batch` do.
"""

from __future__ import annotations

import argparse
import os
import socket
import subprocess
import sys
import tempfile
import time
from contextlib import ExitStack
from functools import partial
from pathlib import Path

from measure import row, table

from esd.learning.model import load_model
from esd.parallel import Workers, outcomes


def nothing(job: int, *, model: object) -> int:
    """The job, and nothing more."""
    return job


def resident(process: int) -> float:
    """Megabytes of memory of a process."""
    pages = int(Path(f"/proc/{process}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--jobs", type=int, default=6000)
    parser.add_argument("--every", type=int, default=1000)
    options = parser.parse_args()
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    address = f"tcp://127.0.0.1:{port}"
    dask = [sys.executable, "-m", "dask"]
    here = os.environ | {"PYTHONPATH": os.pathsep.join([*sys.path[1:], str(Path(__file__).parent)])}
    with ExitStack() as stack:
        quiet = {
            "env": here,
            "cwd": stack.enter_context(tempfile.TemporaryDirectory()),
            "stderr": subprocess.DEVNULL,
        }

        def started(*arguments: str) -> subprocess.Popen:
            process = stack.enter_context(subprocess.Popen([*dask, *arguments], **quiet))
            stack.callback(process.terminate)
            return process

        scheduler = started("scheduler", "--port", str(port), "--no-dashboard")
        started("worker", address, "--nthreads", "1", "--no-nanny", "--no-dashboard")
        work = partial(nothing, model=load_model("default"))
        table("jobs", "scheduler, MB", "client, MB", "CPU ms a job, client")
        start = time.process_time()
        workers = Workers(scheduler=address)
        for done, outcome in enumerate(outcomes(work, range(options.jobs), workers=workers), 1):
            assert outcome.failure is None, outcome.failure
            if done in (100, options.jobs) or done % options.every == 0:
                spent = 1000 * (time.process_time() - start) / done
                sizes = (resident(scheduler.pid), resident(os.getpid()))
                row(done, *(f"{size:.0f}" for size in sizes), f"{spent:.1f}")


if __name__ == "__main__":
    main()
