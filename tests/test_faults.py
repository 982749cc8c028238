"""What becomes of files, caches and exit codes when things break in the middle."""

import json
import os
import re
import resource
import signal
import subprocess
import sys
import time
import zipfile
from pathlib import Path

import numpy as np
import pytest

from esd.common import InputError, whole_file
from esd.learning.model import load_model
from esd.matching.correspondence import load_map
from esd.mesh.io.meshes import write_mesh
from esd.mesh.mesh import Mesh
from esd.mesh.shapes import torus
from esd.spectral.cache import Cache, default_cache
from esd.spectral.spectrum import spectrum

ESD = [sys.executable, "-m", "esd"]


def run(*arguments, limit: int | None = None, **environment) -> subprocess.CompletedProcess[str]:
    """The command, where no file may grow beyond a limit of bytes: as on a full disk."""
    return subprocess.run(
        [*ESD, *map(str, arguments)],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, **environment},
        preexec_fn=limit and (lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))),
    )


def match(shapes: Path, output: Path, *more: str, **options) -> subprocess.CompletedProcess[str]:
    pair = shapes / "tr_reg_000.off", shapes / "tr_reg_010.off"
    return run("match", *pair, "-m", "hks", "-o", output, *more, **options)


def is_one_line(text: str) -> bool:
    text = re.sub(r"^esd: \w+: \d+ of \d+, .*\n", "", text, flags=re.M)  # progress, if it is slow
    return text.count("\n") == 1 and text.startswith("esd: ") and "Traceback" not in text


def left_over(folder: Path) -> list[Path]:
    return list(folder.rglob(".esd-*"))


def wait_for(path: Path, process: subprocess.Popen) -> None:
    for _ in range(12_000):
        if path.exists():
            return
        assert process.poll() is None, "the command ended by itself"
        time.sleep(0.05)
    raise AssertionError(f"{path} did not appear")


def test_a_training_that_is_killed_goes_on_and_becomes_the_same(shapes, tmp_path):
    command = ["train", shapes, "--preset", "paper-hks", "--steps", 1500, "--seed", 3]
    checkpoint = tmp_path / "m.checkpoint"
    broken = subprocess.Popen([*ESD, *map(str, command), "-o", str(tmp_path / "m")])
    wait_for(checkpoint, broken)
    broken.kill()
    broken.wait()
    assert not (tmp_path / "m").exists()
    again = run(*command, "-o", tmp_path / "m")
    assert again.returncode == 0, again.stderr
    assert "1500 steps" in again.stdout
    assert not checkpoint.exists()
    run(*command, "-o", tmp_path / "whole")
    resumed, whole = load_model(tmp_path / "m"), load_model(tmp_path / "whole")
    for layer, other in zip(resumed.layers, whole.layers, strict=True):
        np.testing.assert_array_equal(layer.weight, other.weight)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_ended_command_leaves_one_line_at_most_and_no_file(tmp_path, number):
    code = (
        "import signal, sys, time; from pathlib import Path; from esd.cli import app\n"
        # as in a terminal: what runs in the background may have been set to ignore it
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "from esd.common import whole_file\n"
        "def slow(args):\n"
        "    with whole_file(sys.argv[1] + '/map.csv') as t:\n"
        "        t.write_text('half'); Path(sys.argv[1], 'here').touch(); time.sleep(60)\n"
        "app.app = slow; app.main()\n"
    )
    broken = subprocess.Popen(
        [sys.executable, "-c", code, str(tmp_path)], stderr=subprocess.PIPE, text=True
    )
    wait_for(tmp_path / "here", broken)
    broken.send_signal(number)
    _, said = broken.communicate()
    assert broken.returncode == 128 + number
    assert said in ("", "esd: interrupted\n")
    assert [path.name for path in tmp_path.iterdir()] == ["here"]


LONG = {
    "train": ("train", "set", "--preset", "paper-hks", "-o", "m"),
    "evaluate": ("evaluate", "set", "-m", "default"),
    "batch": ("batch", "pairs.csv", "-o", "maps"),
    "precompute": ("precompute", "set", "-o", "s.h5"),
    "reproduce": ("reproduce", "table1", "--data", "set", "-o", "report"),
}


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has other signals")
@pytest.mark.parametrize(
    ("command", "number"),
    [
        *((name, signal.SIGINT) for name in LONG),
        ("evaluate", signal.SIGTERM),
        ("reproduce", signal.SIGTERM),
    ],
)
def test_long_commands_end_soon_without_a_word_of_their_processes(tmp_path, command, number):
    (tmp_path / "set").mkdir()
    (tmp_path / "tmp").mkdir()
    mesh = torus(60, 40)
    for i in range(30):  # no command is done with them in the seconds below
        bent = Mesh(mesh.vertices * (1, 1, 1 + 0.02 * i), mesh.faces)
        write_mesh(bent, tmp_path / "set" / f"{i}.off")
    lines = [f"set/{i}.off,set/{j}.off\n" for i in range(30) for j in range(i)]
    (tmp_path / "pairs.csv").write_text("source,target\n" + "".join(lines))
    before = {path.name for path in tmp_path.iterdir()}
    process = subprocess.Popen(
        [*ESD, *LONG[command]],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        env={**os.environ, "TMPDIR": str(tmp_path / "tmp"), "ESD_CACHE": "off"},
    )
    time.sleep(4)  # by then its processes work; what is tested must hold at any time
    assert process.poll() is None
    # a terminal sends Ctrl-C to all processes of a command, `kill` sends to one
    os.killpg(process.pid, number) if number == signal.SIGINT else process.send_signal(number)
    start = time.monotonic()
    _, said = process.communicate(timeout=60)
    assert process.returncode == 128 + number
    assert time.monotonic() - start < 15  # one second is usual; the machine may be busy
    assert "Traceback" not in said
    assert all(line.startswith("esd: ") for line in said.splitlines() if line), said
    # torch leaves an empty folder of its own
    assert not [path for path in (tmp_path / "tmp").rglob("*") if path.is_file()]
    kept = {"maps", "s.h5.parts", "report", "m.checkpoint"}  # from which a rerun resumes
    assert {path.name for path in tmp_path.iterdir()} - before <= kept


def test_killed_while_writing_the_old_file_stays(tmp_path):
    path = tmp_path / "map.csv"
    path.write_text("old")
    code = (
        "import os, signal, sys; from esd.common import whole_file\n"
        "with whole_file(sys.argv[1]) as t:\n"
        "    t.write_text('half'); os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    done = subprocess.run([sys.executable, "-c", code, str(path)], check=False)
    assert done.returncode == -signal.SIGKILL
    assert path.read_text() == "old"
    with whole_file(path) as temporary:
        temporary.write_text("new")
    assert path.read_text() == "new"


def test_killed_while_caching_nothing_is_found_next_time(tmp_path):
    code = (
        "import os, signal, sys, numpy as np; from pathlib import Path\n"
        "from esd.spectral.cache import Cache\n"
        "def half(file, **arrays):\n"
        "    Path(file).write_bytes(b'PK'); os.kill(os.getpid(), signal.SIGKILL)\n"
        "np.savez = half\n"
        "Cache(Path(sys.argv[1]), 10**9).store('key', {'a': np.ones(3)})\n"
    )
    done = subprocess.run([sys.executable, "-c", code, str(tmp_path)], check=False)
    assert done.returncode == -signal.SIGKILL
    cache = Cache(tmp_path, 10**9)
    assert cache.load("key") is None
    assert cache.computed("key", lambda: {"a": np.ones(3)})["a"].sum() == 3
    assert cache.load("key") is not None
    assert len(left_over(tmp_path)) == 1  # counts as an entry, so that it goes in its turn
    Cache(tmp_path, 1).store("other", {"a": np.ones(3)})
    assert [path.name for path in tmp_path.iterdir()] == ["other.npz"]


def test_a_precomputing_that_is_killed_goes_on_and_clears_up(shapes, tmp_path):
    store = tmp_path / "s.h5"
    code = (
        "import os, signal, sys, numpy as np; from pathlib import Path\n"
        "from esd.cli import main\n"
        "save = np.savez\n"
        "def second_half(file, **arrays):\n"
        "    if list(Path(file).parent.glob('described*')):\n"
        "        Path(file).write_bytes(b'PK'); os.kill(os.getpid(), signal.SIGKILL)\n"
        "    save(file, **arrays)\n"
        "np.savez = second_half\n"
        "main()\n"
    )
    command = ["precompute", shapes, "-o", store, "--preset", "paper-hks", "--workers", 1]
    environment = {**os.environ, "ESD_CACHE": "off"}
    killed = subprocess.run(
        [sys.executable, "-c", code, *map(str, command)], check=False, env=environment
    )
    assert killed.returncode == -signal.SIGKILL
    assert not store.exists()
    assert len(left_over(tmp_path)) == 1
    again = run(*command, ESD_CACHE="off")
    assert again.returncode == 0, again.stderr
    assert "3 shapes computed, 1 unchanged" in again.stdout, again.stdout
    assert sorted(path.name for path in tmp_path.iterdir()) == ["s.h5", "set"]


def test_a_full_disk_is_reported_in_a_line_and_the_old_file_stays(shapes, tmp_path):
    output = tmp_path / "map.csv"
    output.write_text("old")
    done = match(shapes, output, "--force", limit=1000, ESD_CACHE="off")
    assert done.returncode == 1
    assert is_one_line(done.stderr), done.stderr
    assert "too large" in done.stderr
    assert output.read_text() == "old"
    assert left_over(tmp_path) == []


def test_a_cache_on_a_full_disk_costs_only_a_warning(shapes, tmp_path):
    done = match(shapes, tmp_path / "map.csv", limit=100_000, ESD_CACHE=str(tmp_path / "cache"))
    assert done.returncode == 0, done.stderr
    assert "cannot be written to" in done.stderr
    assert "Traceback" not in done.stderr
    assert left_over(tmp_path) == []


def test_a_checkpoint_on_a_full_disk_ends_the_training_in_a_line(shapes, tmp_path):
    command = ("train", shapes, "--preset", "paper-hks", "--steps", 1, "-o", tmp_path / "m")
    done = run(*command, limit=20_000, ESD_CACHE="off")
    assert done.returncode == 1
    assert is_one_line(done.stderr), done.stderr
    assert "m.checkpoint' cannot be written: File too large" in done.stderr
    assert not (tmp_path / "m").exists()
    assert left_over(tmp_path) == []


def test_precomputing_on_a_full_disk_tells_what_failed(shapes, tmp_path):
    command = ("precompute", shapes, "--preset", "paper-hks", "--workers", 1)
    done = run(*command, "-o", tmp_path / "s.h5", limit=20_000, ESD_CACHE="off")
    assert done.returncode == 1
    assert is_one_line(done.stderr), done.stderr
    assert done.stdout.count("File too large") == 4, done.stdout
    assert not (tmp_path / "s.h5").exists()
    assert left_over(tmp_path) == []


@pytest.mark.skipif(not Path("/proc").is_dir(), reason="needs a folder no one can write to")
def test_a_folder_that_cannot_be_written_to_is_reported(shapes, tmp_path):
    done = match(shapes, Path("/proc/map.csv"))
    assert done.returncode == 1
    assert is_one_line(done.stderr), done.stderr
    done = run("train", shapes, "--preset", "paper-hks", "--steps", 1, "-o", "/proc/model")
    assert done.returncode == 1
    assert is_one_line(done.stderr), done.stderr
    done = match(shapes, tmp_path / "map.csv", ESD_CACHE="/proc/cache")
    assert done.returncode == 0, done.stderr
    assert "cannot be written to" in done.stderr


def test_two_processes_share_a_cache_that_a_third_clears(shapes, tmp_path):
    environment = {**os.environ, "ESD_CACHE": str(tmp_path / "cache")}
    pair = [str(shapes / "tr_reg_000.off"), str(shapes / "tr_reg_010.off")]
    outputs = [tmp_path / f"{i}.npy" for i in range(2)]
    both = [
        subprocess.Popen(
            [*ESD, "match", *pair, "-m", "hks", "-o", str(output), "--json"],
            stderr=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env=environment,
        )
        for output in outputs
    ]
    cache = Cache(tmp_path / "cache", 10**9)
    while any(process.poll() is None for process in both):
        cache.clear()
        time.sleep(0.01)
    for process in both:
        said, complained = process.communicate()
        assert process.returncode == 0, complained
        assert json.loads(said)["matched"] == 384
    np.testing.assert_array_equal(np.load(outputs[0]), np.load(outputs[1]))


def test_a_cache_of_another_version_is_not_read(blob, monkeypatch):
    import esd.spectral.spectrum as module

    cache = default_cache()
    first = spectrum(blob, 20, cache=cache)
    for path, _ in cache.entries():
        np.savez(path, eigenvalues=np.zeros(1))  # what another version might keep under its key
    monkeypatch.setattr(module, "_SOLVER_VERSION", "another")
    second = spectrum(blob, 20, cache=cache)
    np.testing.assert_allclose(second.eigenvalues, first.eigenvalues, atol=1e-9)
    cache.clear()


@pytest.mark.parametrize("damage", ["cut", "noise", "empty", "bomb", "pickle", "method"])
def test_damaged_cache_entries_are_computed_again(tmp_path, caplog, damage):
    cache = Cache(tmp_path, 10**9)
    cache.store("key", {"a": np.arange(1000.0)})
    path = tmp_path / "key.npz"
    if damage == "cut":
        path.write_bytes(path.read_bytes()[:500])
    elif damage == "noise":
        path.write_bytes(np.random.default_rng(0).bytes(5000))
    elif damage == "empty":
        path.write_bytes(b"")
    elif damage == "method":
        content = path.read_bytes()
        place = content.index(b"PK\1\2") + 10  # where the list of contents has the compression
        path.write_bytes(content[:place] + b"\x63" + content[place + 1 :])
    elif damage == "bomb":
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
            archive.writestr("a.npy", bytes(10**7))
    else:
        np.savez(path, a=np.array([{}], dtype=object), allow_pickle=True)
    assert cache.computed("key", lambda: {"a": np.ones(3)})["a"].sum() == 3
    assert "is damaged and is computed again" in caplog.text
    assert cache.load("key")["a"].sum() == 3


def test_arrays_that_promise_more_than_they_hold_are_refused(tmp_path):
    path = tmp_path / "map.npy"
    head = (
        b"\x93NUMPY\x01\x00v\x00{'descr': '<i8', 'fortran_order': False, 'shape': (10000000000,), }"
    )
    path.write_bytes(head.ljust(127) + b"\n" + bytes(24))
    with pytest.raises(InputError, match="holds no array"):
        load_map(path, source_count=3, target_count=3)


def test_models_that_mean_harm_are_refused(tmp_path):
    folder = tmp_path / "m"
    folder.mkdir()
    config = folder / "config.json"
    config.write_text("[" * 100_000)
    with pytest.raises(InputError, match="is damaged"):
        load_model(folder)
    with config.open("wb") as file:
        file.truncate(2**26 + 1)
    with pytest.raises(InputError, match="larger than any model"):
        load_model(folder)
    config.write_text('{"format": 1}')
    weights = folder / "model.safetensors"
    for content in (b"", b"\x80\x04]", (2**60).to_bytes(8, "little") + b"{}"):
        weights.write_bytes(content)
        with pytest.raises(InputError, match="is damaged"):
            load_model(folder)
    with weights.open("wb") as file:
        file.truncate(2**30 + 1)
    with pytest.raises(InputError, match="larger than any model"):
        load_model(folder)
