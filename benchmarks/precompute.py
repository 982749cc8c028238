"""What `esd precompute` costs on one process, two, and a Dask cluster of two workers.

    python benchmarks/precompute.py bodies --include 's1[0-3]_p00,s1[0-3]_p03'

The cluster is started as a user would. With `--kill`, one of its workers is killed when a quarter
of the shapes is done. The stores must be the same to the byte. Below, what 40,000 such shapes take.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import threading
import time
from contextlib import ExitStack, contextmanager
from pathlib import Path

from measure import ROOT, cost, row, table

SHAPES = 40_000


@contextmanager
def process(*command: object):
    environment = os.environ | {"PYTHONPATH": str(ROOT / "src"), "ESD_CACHE": "off"}
    started = subprocess.Popen(
        [sys.executable, "-m", *map(str, command)], stderr=subprocess.DEVNULL, env=environment
    )
    try:
        yield started
    finally:
        started.terminate()
        started.wait()


@contextmanager
def cluster(folder: Path):
    """Address of a scheduler and its two workers."""
    contact = folder / "scheduler.json"
    common = ("--scheduler-file", contact, "--no-dashboard")
    with ExitStack() as stack:
        stack.enter_context(process("distributed.cli.dask_scheduler", *common, "--port", 0))
        while not contact.exists():
            time.sleep(0.1)
        worker = ("distributed.cli.dask_worker", *common, "--nthreads", 1, "--no-nanny")
        worker += ("--local-directory", folder)
        workers = [stack.enter_context(process(*worker)) for _ in range(2)]
        time.sleep(5)
        yield contact, workers


def kill_when_some_are_done(worker: subprocess.Popen, parts: Path, count: int) -> None:
    while len([*parts.glob("[!.]*.npz")]) < count:
        time.sleep(0.05)
    worker.kill()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("dataset", nargs="?", default="bodies")
    parser.add_argument("--include", default="s1[0-3]_p00,s1[0-3]_p03")
    parser.add_argument("--preset", default="paper-hks")
    parser.add_argument("--rounds", type=int, default=1)
    parser.add_argument("--kill", action="store_true")
    options = parser.parse_args()
    import json

    from esd.datasets.open import open_collection

    shapes = len(open_collection(options.dataset).including(options.include).shapes)
    best, stores = {}, set()
    with tempfile.TemporaryDirectory() as name, cluster(Path(name)) as (contact, workers):
        address = json.loads(contact.read_text())["address"]
        ways = {"one process": ["--workers", "1"], "two processes": ["--workers", "2"]}
        ways["Dask, two workers"] = ["--scheduler", address]
        if options.kill:
            ways["Dask, one of two workers killed"] = ["--scheduler", address]
        for way, how in [*ways.items()] * options.rounds:
            store = Path(name) / "store.h5"
            if "killed" in way:
                parts = store.with_name(store.name + ".parts")
                killing = (workers[0], parts, max(1, shapes // 4))
                threading.Thread(target=kill_when_some_are_done, args=killing, daemon=True).start()
            command = [sys.executable, "-m", "esd", "precompute", options.dataset, "-o", str(store)]
            command += ["--include", options.include, "--preset", options.preset, "--force", *how]
            found = cost(command)
            stores.add(store.read_bytes())
            if way not in best or found.wall < best[way].wall:
                best[way] = found
    table(f"{shapes} shapes", "", "wall s", "× wall", "CPU s", "peak MB")
    first = best["one process"]
    for way, found in best.items():
        cpu = f"{found.cpu:.1f}" if "Dask" not in way else "–"
        ratio = f"{first.wall / found.wall:.2f}"
        row(way, "", f"{found.wall:.1f}", ratio, cpu, f"{found.memory:.0f}")
    print(f"\nstores: {len(stores)} different\n")
    each = first.cpu / shapes
    table(f"{SHAPES:,} such shapes", f"{each:.2f} s of a core each", *["1 core", "10", "100"])
    row("hours", "", *(f"{SHAPES * each / 3600 / cores:.2g}" for cores in (1, 10, 100)))


if __name__ == "__main__":
    main()
