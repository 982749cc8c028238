"""A Dask cluster as a user starts one; every step ends by a time limit."""

import json
import os
import socketserver
import subprocess
import sys
import threading
import time
from contextlib import contextmanager
from pathlib import Path

import pytest

from esd.common import InputError
from esd.mesh.io.meshes import write_mesh
from esd.mesh.shapes import torus
from esd.parallel import Workers, outcomes

pytest.importorskip("distributed", reason="a cluster needs the extra `cluster`")

LIMIT = 180  # seconds for any step; a few are usual
HERE = str(Path(__file__).parent)
JOBS = 12

OUTCOMES = """
import sys
from esd.parallel import Workers, outcomes
from test_cluster import slow_square, JOBS
for outcome in outcomes(slow_square, range(JOBS), workers=Workers(scheduler=sys.argv[1])):
    print(outcome.job, outcome.result, outcome.failure, flush=True)
"""


def slow_square(number: int) -> int:
    time.sleep(0.3)
    return number**2


@contextmanager
def started(command: list[str], folder: Path, **options):
    """A process that is gone at the end of the block, and at the end of its time at the latest."""
    environment = os.environ | {
        "PYTHONPATH": os.pathsep.join([HERE, *sys.path]),
        "DASK_DISTRIBUTED__COMM__TIMEOUTS__CONNECT": f"{LIMIT}s",
        "ESD_CACHE": "off",
    }
    with (folder / "log").open("a") as log:
        process = subprocess.Popen(command, cwd=folder, env=environment, stderr=log, **options)
    watch = threading.Timer(LIMIT, process.kill)
    watch.start()
    try:
        yield process
    finally:
        watch.cancel()
        process.kill()
        process.wait()
        if process.stdout is not None:
            process.stdout.close()


@pytest.fixture
def scheduler(tmp_path):
    """Address of a scheduler without workers."""
    python = [sys.executable, "-m"]
    contact = tmp_path / "scheduler.json"
    scheduler = [*python, "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0"]
    scheduler += ["--no-dashboard", "--scheduler-file", str(contact)]
    with started(scheduler, tmp_path):
        deadline = time.monotonic() + LIMIT
        while not (contact.exists() and contact.read_text()):
            assert time.monotonic() < deadline, (tmp_path / "log").read_text()
            time.sleep(0.1)
        address = json.loads(contact.read_text())["address"]
        yield address


@pytest.fixture
def cluster(scheduler, tmp_path):
    """Address of a scheduler, and its two workers."""
    worker = [sys.executable, "-m", "distributed.cli.dask_worker", scheduler]
    worker += ["--nthreads", "1", "--no-nanny", "--no-dashboard"]
    worker += ["--local-directory", str(tmp_path)]
    with started(worker, tmp_path) as first, started(worker, tmp_path) as second:
        yield scheduler, (first, second)


def test_a_cluster_without_workers_is_not_waited_for_without_end(scheduler, tmp_path):
    code = (
        "import sys, esd.parallel as parallel; from esd.cli import main\n"
        "parallel._SILENCE = 0.5\n"
        "main()\n"
    )
    write_mesh(torus(12, 8), tmp_path / "a.off")
    (tmp_path / "pairs.csv").write_text("source,target\na.off,a.off\n")
    command = [sys.executable, "-c", code, "batch", "pairs.csv", "-m", "gps"]
    command += ["--scheduler", scheduler, "--patience", "3"]
    with started(command, tmp_path) as process:
        assert process.wait() == 1
    said = (tmp_path / "log").read_text()
    assert "esd: The scheduler has no workers yet; waiting for some." in said
    assert "esd: The scheduler has had no workers for 3 s. Start some by" in said


@contextmanager
def answering(content: bytes):
    """Port of a server that sends so much to whoever connects, and then waits."""
    done = threading.Event()

    class Handler(socketserver.BaseRequestHandler):
        def handle(self):
            self.request.sendall(content)
            done.wait(LIMIT)

    with socketserver.ThreadingTCPServer(("127.0.0.1", 0), Handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        try:
            yield server.server_address[1]
        finally:
            done.set()
            server.shutdown()


def refused_by(address: str, patience: float) -> str:
    with pytest.raises(InputError) as refused:
        list(outcomes(slow_square, [1], workers=Workers(scheduler=address, patience=patience)))
    return str(refused.value)


def test_what_is_no_scheduler_is_refused_in_time(monkeypatch, caplog):
    monkeypatch.setattr("esd.parallel._SILENCE", 0.2)
    with answering(b"") as port:
        said = refused_by(f"tcp://127.0.0.1:{port}", 1.0)
    assert "No Dask scheduler answered at" in said
    assert "within 1 s. Start one by `dask scheduler`" in said
    assert "No scheduler has answered at 'tcp://127.0.0.1" in caplog.text
    with answering(b"HTTP/1.1 400 Bad Request\r\n\r\n" * 100) as port:
        said = refused_by(f"tcp://127.0.0.1:{port}", 30.0)
    assert "is no Dask scheduler, or one of a version" in said


def test_a_cluster_computes_the_same_bytes_and_outlives_a_worker(cluster, shapes, tmp_path):
    address, workers = cluster
    made = [sys.executable, "-m", "esd", "precompute", str(shapes), "-m", "gps", "-o"]
    for name, how in (("cluster.h5", ["--scheduler", address]), ("here.h5", ["--workers", "1"])):
        with started([*made, name, *how], tmp_path) as process:
            assert process.wait() == 0, (tmp_path / "log").read_text()
    assert (tmp_path / "cluster.h5").read_bytes() == (tmp_path / "here.h5").read_bytes()

    command = [sys.executable, "-c", OUTCOMES, address]
    with started(command, tmp_path, stdout=subprocess.PIPE, text=True) as process:
        lines = [process.stdout.readline()]
        workers[0].kill()
        lines += process.stdout.readlines()
        assert process.wait() == 0, (tmp_path / "log").read_text()
    assert sorted(lines) == sorted(f"{i} {i**2} None\n" for i in range(JOBS))


def test_a_cluster_matches_and_evaluates_as_one_process_does(cluster, shapes, tmp_path):
    address, _ = cluster
    (tmp_path / "pairs.csv").write_text(
        "source,target\nset/tr_reg_000.off,set/tr_reg_010.off\nset/tr_reg_020.off,set/tr_reg_000.off\n"
    )
    esd = [sys.executable, "-m", "esd"]
    figures, maps = [], []
    for folder, how in (("there", ["--scheduler", address]), ("here", ["--workers", "1"])):
        (tmp_path / folder).mkdir()
        command = [*esd, "batch", "pairs.csv", "-m", "gps", "-o", folder, *how]
        with started(command, tmp_path) as process:
            assert process.wait() == 0, (tmp_path / "log").read_text()
        maps.append([path.read_bytes() for path in sorted((tmp_path / folder).glob("*.csv"))])
        command = [*esd, "evaluate", "set", "-m", "gps", "--json", *how]
        with started(command, tmp_path, stdout=subprocess.PIPE, text=True) as process:
            figures.append(json.loads(process.stdout.read()) | {"seconds": 0})
    assert len(maps[0]) == 2
    assert maps[0] == maps[1]
    assert figures[0] == figures[1]
    assert not list(tmp_path.glob(".esd-*"))


def test_a_cluster_makes_the_same_atlas(cluster, shapes, tmp_path):
    address, _ = cluster
    made = [sys.executable, "-m", "esd", "atlas", str(shapes), "-m", "gps", "--keep-failed", "-o"]
    found = []
    for name, how in (("there", ["--scheduler", address]), ("here", ["--workers", "1"])):
        with started([*made, name, *how], tmp_path) as process:
            assert process.wait() == 0, (tmp_path / "log").read_text()
        files = sorted((tmp_path / name).rglob("*.*"))
        # archives hold the time
        found.append({f.relative_to(tmp_path / name): f.read_bytes() for f in files})
        del found[-1][Path("model.npz")]
    assert len(found[0]) > 10
    assert found[0] == found[1]
    assert not list(tmp_path.glob(".esd-*"))
