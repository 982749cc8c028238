"""`esd atlas`."""

import json
import subprocess
import sys

import numpy as np
import pytest

from esd.mesh.io.meshes import write_mesh
from esd.mesh.mesh import Mesh
from esd.mesh.shapes import icosphere


@pytest.fixture
def ellipsoids(tmp_path):
    """Five meshes of one connectivity, and their folder."""
    sphere = icosphere(2)
    for i in range(5):
        write_mesh(
            Mesh(sphere.vertices * [1 + 0.1 * i, 1, 1], sphere.faces), tmp_path / "in" / f"e{i}.off"
        )
    return tmp_path / "in"


def test_an_atlas_of_registered_meshes_is_written_and_replaced_only_by_itself(
    run, ellipsoids, tmp_path
):
    out = tmp_path / "out"
    done = run("atlas", ellipsoids, "-o", out, "--registered", "--json")
    summary = json.loads(done.stdout)
    assert (summary["shapes"], summary["left_out"], summary["outliers"]) == (5, {}, [])
    assert summary["explained"][0] > 0.99
    assert len((out / "scores.csv").read_text().splitlines()) == 6
    assert (out / "report.html").stat().st_size > 500_000
    again = run("atlas", ellipsoids, "-o", out, "--registered", "--modes", 1)
    assert "5 shapes registered to 'e0'; 1 of 1 modes explain" in again.stdout
    with np.load(out / "model.npz") as model:
        assert model["modes"].shape == (1, 162, 3)
    other = run("atlas", ellipsoids, "-o", out, expect=1)
    assert "holds an atlas with another template and model" in other.stderr


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["in", "-o", "in/out"], 1, "lie one in the other"),
        (["in", "-o", "in"], 1, "lie one in the other"),
        (["in", "-o", "."], 1, "lie one in the other"),
        (["in", "-o", "full"], 1, "give --force to replace it"),
        (["in", "-o", "full/a.txt"], 1, "is a file"),
        (["in", "-o", "full/a.txt/out"], 1, "is a file, not a folder"),
        (["none", "-o", "out"], 1, "no data set 'none'"),
        (["in", "-o", "out", "--include", "x*"], 1, "No shape of"),
        (["in", "-o", "out", "--include", "e0", "--registered"], 1, "needs 3 shapes or more"),
        (["in", "-o", "out", "--include", "e[01]"], 1, "needs 3 shapes or more"),
        (["in", "-o", "out", "--template", "none.ply"], 1, "There is no file 'none.ply'"),
        (["in", "-o", "out", "--landmarks", "none"], 1, "no folder of landmarks"),
        (["in", "-o", "out", "--model", "none"], 1, "none"),
        (["in", "-o", "out", "--train", "--model", "default"], 2, "not both"),
        (["in", "-o", "out", "--registered", "--train"], 2, "matches nothing"),
        (["in"], 2, "output"),
    ],
)
def test_what_cannot_be_done_is_refused_before_anything_is(
    run, ellipsoids, tmp_path, monkeypatch, arguments, code, message
):
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "a.txt").write_text("kept")
    monkeypatch.chdir(tmp_path)
    done = run("atlas", *arguments, expect=code)
    assert message in " ".join(done.stderr.split())
    assert (tmp_path / "full" / "a.txt").read_text() == "kept"
    assert not (tmp_path / "out" / "scores.csv").exists()
    assert len(list(ellipsoids.iterdir())) == 5


KILLED = """
import json, os, signal, sys
from importlib import import_module
from esd.cli import main

def run_until(name, calls):
    module, _, call = name.rpartition(".")
    before = getattr(import_module(module), call)

    def dies(*arguments, **options):
        nonlocal calls
        calls -= 1
        if calls < 0:
            os.kill(os.getpid(), signal.SIGKILL)
        return before(*arguments, **options)

    setattr(sys.modules[module], call, dies)
    main()

steps = json.loads(sys.argv.pop(1))
for name, _ in steps:
    import_module(name.rpartition(".")[0])
for name, calls in steps:  # each in a process of its own, which starts with all that is imported
    child = os.fork()
    if child == 0:
        run_until(name, calls)
        os._exit(0)
    ended = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    assert ended == -signal.SIGKILL, (name, ended)
"""


def content(folder):
    """All that an atlas consists of, and the names of its files."""
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    # archives hold the time
    texts = [path.read_bytes() for path in files if path.suffix != ".npz"]
    with np.load(folder / "model.npz") as model:
        arrays = [model[name].tobytes() for name in sorted(model)]
    return [path.relative_to(folder) for path in files], texts, arrays


def test_a_run_that_is_killed_anywhere_resumes_with_the_same_result(run, shapes, tmp_path):
    options = [shapes, "--model", "gps", "--keep-failed", "--workers", "1"]
    run("atlas", *options, "-o", tmp_path / "at_once")
    steps = [
        ("esd.population.atlas.shape_dna", 2),  # some shapes are looked at as templates
        ("esd.population.atlas._write_settings", 0),  # the template is written, not its name
        ("esd.population.registering.register", 1),  # one shape is registered
        ("esd.population.registering.asdict", 1),  # another one, but for its figures
        ("esd.population.atlas.principal_components", 0),
        ("numpy.savez_compressed", 0),  # a file is begun
        ("esd.population.files._write_table", 1),  # some tables are there
        ("esd.viewing.report.report", 0),
    ]
    command = ["atlas", *options, "-o", tmp_path / "killed"]
    done = subprocess.run(
        [sys.executable, "-c", KILLED, json.dumps(steps), *command],
        check=False,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    summary = json.loads(run("atlas", *options, "-o", tmp_path / "killed", "--json").stdout)
    assert summary["computed"] == 0  # all were registered before the statistics
    assert content(tmp_path / "killed") == content(tmp_path / "at_once")


def test_a_model_is_trained_once(ellipsoids, tmp_path, monkeypatch):
    pytest.importorskip("torch", reason="torch is not installed")
    from esd.cli import atlas as command
    from esd.datasets.open import open_collection
    from esd.learning import unsupervised
    from esd.learning.model import load_model
    from esd.learning.unsupervised import TeachingProgress
    from esd.parallel import THIS_PROCESS

    trained = []

    def training(collection, preset, *, on_progress, on_shape, **options):
        trained.append(collection.name)
        on_shape()
        on_progress(TeachingProgress(50, 400, None, None, None))
        return load_model("default")

    monkeypatch.setattr(unsupervised, "train_unsupervised", training)
    collection = open_collection(ellipsoids)
    for _ in range(2):
        model = command._model(
            collection, None, tmp_path / "out", THIS_PROCESS, train=True, device="cpu"
        )
        assert model.name == "trained"
    assert trained == ["in"]
    assert (
        command._model(
            collection, None, tmp_path / "out", THIS_PROCESS, train=False, device="cpu"
        ).name
        == "oriented"
    )
