import asyncio
import logging
import os
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from threadpoolctl import ThreadpoolController, threadpool_limits

from esd import parallel
from esd.common import InputError
from esd.parallel import (
    Workers,
    blas_libraries,
    outcomes,
    shared_folder,
    side_by_side,
    thread_count,
)

HERE = str(Path(__file__).parent)


def square(number: int) -> int:
    if number == 3:
        raise InputError("not three")
    if number == 4:
        raise KeyError("four")
    return number**2


def square_or_die(number: int) -> int:
    if number == 5:
        os.kill(os.getpid(), signal.SIGKILL)
    return number**2


def sleep(path: str) -> None:
    Path(path).write_text(str(os.getpid()))
    time.sleep(60)


@pytest.mark.parametrize("workers", [1, 2])
def test_jobs_that_fail_do_not_abort_the_others(workers):
    found = {
        outcome.job: outcome for outcome in outcomes(square, range(20), workers=Workers(workers))
    }
    assert sorted(found) == list(range(20))
    assert found[3].failure == "not three"
    assert found[4].failure == "KeyError: 'four'"
    assert all(found[i].result == i**2 for i in found if i not in (3, 4))


@pytest.mark.skipif(sys.platform == "win32", reason="there is no SIGKILL on Windows")
def test_a_job_that_kills_its_process_fails_alone():
    found = {
        outcome.job: outcome for outcome in outcomes(square_or_die, range(12), workers=Workers(2))
    }
    assert "died" in found.pop(5).failure
    assert {job: outcome.result for job, outcome in found.items()} == {
        i: i**2 for i in range(12) if i != 5
    }


@pytest.mark.skipif(sys.platform == "win32", reason="there is no SIGKILL on Windows")
def test_processes_end_when_their_parent_is_killed(tmp_path):
    code = (
        "import test_parallel as t, esd.parallel as w; from esd.parallel import outcomes\n"
        f"if __name__ == '__main__': list(outcomes(t.sleep, [r'{tmp_path / 'a'}'], workers=w.Workers(2)))"
    )
    script = tmp_path / "script.py"
    script.write_text(code)
    path = os.pathsep.join([HERE, *sys.path])
    parent = subprocess.Popen([sys.executable, script], env={**os.environ, "PYTHONPATH": path})
    deadline = time.monotonic() + 30
    while not (tmp_path / "a").exists() or not (tmp_path / "a").read_text():
        assert time.monotonic() < deadline
        time.sleep(0.05)
    worker = int((tmp_path / "a").read_text())
    parent.kill()
    parent.wait()
    while _runs(worker):
        assert time.monotonic() < deadline
        time.sleep(0.05)


def warn(number: int) -> None:
    logging.getLogger("esd").warning("job %d", number)
    logging.getLogger("esd").info("not asked for")


def test_processes_log_as_their_parent_does(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(
        "import logging, test_parallel as t; from esd.parallel import Workers, outcomes\n"
        "if __name__ == '__main__':\n"
        "    logging.basicConfig(format='esd: %(message)s', level=logging.WARNING)\n"
        "    list(outcomes(t.warn, [1], workers=Workers(2)))\n"
    )
    path = os.pathsep.join([HERE, *sys.path])
    done = subprocess.run(
        [sys.executable, script],
        env={**os.environ, "PYTHONPATH": path},
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stderr == "esd: job 1\n"


def _runs(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    status = Path(f"/proc/{process}/stat")  # where nobody collects orphans, they stay as zombies
    return not (status.exists() and status.read_text().rpartition(")")[2].split()[0] == "Z")


def wait_or_not(seconds: int) -> int:
    time.sleep(seconds)
    return seconds


def test_whoever_stops_early_does_not_wait_for_jobs_that_run():
    start = time.monotonic()
    found = outcomes(wait_or_not, [0, 60, 60, 60, 60], workers=Workers(2))
    assert next(found).result == 0
    found.close()
    assert time.monotonic() - start < 30  # starting two processes may take some of it


@pytest.mark.skipif(sys.platform == "win32", reason="there, processes are supposed to run")
def test_folders_of_processes_that_were_killed_are_removed(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    cluster = Workers(scheduler="tcp://host:8786")
    with shared_folder(cluster) as folder:
        host = folder.name.split("-")[1]
        gone = subprocess.Popen([sys.executable, "-c", ""])
        gone.wait()
        left, elsewhere = f".esd-{host}-{gone.pid}-x", f".esd-other-{gone.pid}-x"
        mine = f".esd-{host}-{os.getpid()}-x"
        for name in (left, elsewhere, mine):
            Path(name).mkdir()
        with shared_folder(cluster) as second:
            assert second.parent == tmp_path
            assert folder.is_dir()
            assert not Path(left).exists()
            assert Path(elsewhere).is_dir()
            assert Path(mine).is_dir()
    assert not folder.exists()


def test_impossible_settings_are_refused():
    with pytest.raises(InputError, match="`processes` must be at least 1; got 0"):
        list(outcomes(square, [1], workers=Workers(0)))
    with pytest.raises(InputError, match="a number of processes or a scheduler, not both"):
        Workers(2, "tcp://host:8786")
    with pytest.raises(InputError, match="`patience` must be a positive number"):
        Workers(patience=0)
    for address in ("nonsense", "http://host:8787", "tcp://host", "tcp://:8786", "tcp://a b:1"):
        with pytest.raises(InputError, match="not the address of a Dask scheduler; expected one"):
            Workers(scheduler=address)


def test_a_scheduler_that_does_not_answer_is_waited_for_no_longer_than_the_patience():
    pytest.importorskip("distributed", reason="a cluster needs the extra `cluster`")
    start = time.monotonic()
    nobody = Workers(scheduler="tcp://127.0.0.1:9", patience=1)
    with pytest.raises(InputError, match="No Dask scheduler answered"):
        list(outcomes(square, [1], workers=nobody))
    assert time.monotonic() - start < 30

    async def in_a_notebook() -> None:
        list(outcomes(square, [1], workers=nobody))

    # in a thread of its own: other tests leave an event loop running in this one
    with ThreadPoolExecutor(1) as pool:
        found = pool.submit(asyncio.run, in_a_notebook())
        with pytest.raises(InputError, match="No Dask scheduler answered"):
            found.result()


LARGE_RESULTS = """
import sys, time
import numpy as np
from esd.parallel import Workers, outcomes

def large(job):
    return np.zeros(8_000_000 if job else 0)

if __name__ == "__main__":
    for turn in range(10):
        found = outcomes(large, range(40), workers=Workers(2))
        next(found)
        time.sleep(0.03 * (turn % 4))  # so that the processes are at different things
        found.close()
"""


def test_outcomes_may_be_left_while_large_results_are_on_their_way(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(LARGE_RESULTS)
    done = subprocess.run(
        [sys.executable, script], capture_output=True, text=True, check=False, timeout=120
    )
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""


def test_side_by_side_no_job_takes_more_than_one_thread():
    before = thread_count(blas_libraries())
    assert side_by_side(lambda job: (job, thread_count(blas_libraries())), "ab") == [
        ("a", 1),
        ("b", 1),
    ]
    assert thread_count(blas_libraries()) == before
    with pytest.raises(InputError, match="not three"):
        side_by_side(square, [3, 2])


def test_where_one_thread_is_allowed_jobs_stay_in_it():
    with threadpool_limits(1):
        assert set(side_by_side(lambda _: threading.get_ident(), "ab")) == {threading.get_ident()}


def test_libraries_are_looked_for_again_only_after_imports(monkeypatch):
    looked = []

    def controller():
        looked.append(True)
        return ThreadpoolController()

    parallel._libraries.cache_clear()
    monkeypatch.setattr(parallel, "ThreadpoolController", controller)
    for _ in range(3):
        assert thread_count(blas_libraries()) >= 1
    assert len(looked) == 1
    monkeypatch.setitem(sys.modules, "a_module_with_threads", sys)
    blas_libraries()
    assert len(looked) == 2
    parallel._libraries.cache_clear()
