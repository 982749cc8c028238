import os
import signal
import threading
import time

import pytest

from esd.common import InputError
from esd.mesh.io.meshes import write_mesh
from esd.mesh.shapes import icosphere
from esd.studio.jobs import Jobs
from esd.studio.worker import Repair


@pytest.fixture
def ended():
    return []


@pytest.fixture
def jobs(ended):
    queue = Jobs("default", lambda job, result: ended.append((job.number, result)))
    yield queue
    queue.close()


def wait(happened, seconds=60):
    end = time.monotonic() + seconds
    while not happened():
        assert time.monotonic() < end
        time.sleep(0.02)


def state(jobs, number):
    return next(job for job in jobs.list() if job.number == number)


def test_tasks_are_done_in_order_and_what_fails_fails_alone(jobs, ended, tmp_path):
    write_mesh(icosphere(2), tmp_path / "a.off")
    missing = jobs.submit("x", Repair(tmp_path / "none.off", tmp_path / "x.ply"))
    repair = jobs.submit("y", Repair(tmp_path / "a.off", tmp_path / "y.ply"))
    again = jobs.submit("y", Repair(tmp_path / "a.off", tmp_path / "y.ply"))
    assert again.number == repair.number  # it waits already
    wait(lambda: len(ended) == 2)
    assert state(jobs, missing.number).state == "failed"
    assert "none.off" in state(jobs, missing.number).error
    assert ended == [(missing.number, None), (repair.number, {"vertices": 162})]
    with pytest.raises(InputError, match="There is no job 99"):
        jobs.cancel(99)


def test_a_process_that_dies_fails_its_job_and_another_takes_over(jobs, tmp_path):
    write_mesh(icosphere(6), tmp_path / "large.off")
    write_mesh(icosphere(2), tmp_path / "a.off")
    large = jobs.submit("x", Repair(tmp_path / "large.off", tmp_path / "x.ply"))
    wait(lambda: state(jobs, large.number).stage == "Repairing")
    os.kill(jobs._process.pid, signal.SIGKILL)
    wait(lambda: state(jobs, large.number).state == "failed")
    assert "died" in state(jobs, large.number).error
    small = jobs.submit("y", Repair(tmp_path / "a.off", tmp_path / "y.ply"))
    wait(lambda: state(jobs, small.number).state == "done")


@pytest.mark.parametrize(
    ("error", "line"),
    [
        (InputError("A project has at most 200 shapes."), "A project has at most 200 shapes."),
        (OSError(28, "No space left on device"), "[Errno 28] No space left on device"),
    ],
)
def test_what_cannot_be_kept_fails_the_job_and_not_the_queue(tmp_path, error, line):
    write_mesh(icosphere(2), tmp_path / "a.off")

    def full(job, result):
        raise error

    jobs = Jobs("default", full)
    for name in ("x", "y"):
        job = jobs.submit(name, Repair(tmp_path / "a.off", tmp_path / f"{name}.ply"))
        wait(lambda job=job: state(jobs, job.number).state == "failed")
        assert state(jobs, job.number).error == line
    jobs.close()


def test_a_job_is_listed_as_ended_once_its_result_is_kept(tmp_path):
    write_mesh(icosphere(2), tmp_path / "a.off")
    kept, seen = threading.Event(), []

    def keep(job, result):
        if result is not None:
            seen.append((job.state, state(jobs, job.number).state))
            kept.wait()

    jobs = Jobs("default", keep)
    first = jobs.submit("x", Repair(tmp_path / "a.off", tmp_path / "x.ply"))
    wait(lambda: seen)
    assert seen == [("done", "running")]
    jobs.cancel(first.number)  # too late for its process, which does the next one
    second = jobs.submit("y", Repair(tmp_path / "a.off", tmp_path / "y.ply"))
    kept.set()
    wait(lambda: state(jobs, second.number).state == "done")
    assert state(jobs, first.number).state == "cancelled"
    jobs.close()


def test_a_job_may_be_forgotten_before_its_process_ends(jobs, tmp_path, monkeypatch):
    monkeypatch.setattr("esd.studio.jobs._MOST_KEPT", 1)
    write_mesh(icosphere(6), tmp_path / "large.off")
    large = jobs.submit("x", Repair(tmp_path / "large.off", tmp_path / "x.ply"))
    wait(lambda: state(jobs, large.number).stage == "Repairing")
    others = [jobs.submit("y", Repair(tmp_path / "a.off", tmp_path / f"{k}.ply")) for k in range(2)]
    for job in (large, *others):
        jobs.cancel(job.number)
    write_mesh(icosphere(2), tmp_path / "a.off")
    small = jobs.submit("z", Repair(tmp_path / "a.off", tmp_path / "z.ply"))
    wait(lambda: state(jobs, small.number).state == "done")


def test_too_many_tasks_are_refused(jobs, tmp_path, monkeypatch):
    monkeypatch.setattr("esd.studio.jobs._MOST_WAITING", 2)
    with pytest.raises(InputError, match="Too much is waiting"):
        for k in range(4):
            jobs.submit("x", Repair(tmp_path / f"{k}.off", tmp_path / "x.ply"))
