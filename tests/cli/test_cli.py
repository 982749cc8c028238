import json
import os
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np

from command import run
from esd.mesh.io.meshes import write_mesh
from esd.mesh.shapes import icosphere, torus


def files(folder: Path) -> set[str]:
    return {name for _, _, names in os.walk(folder) for name in names}


def test_from_training_to_a_map_and_its_error(shapes, tmp_path):
    model, output = tmp_path / "m", tmp_path / "map.csv"
    run(
        "train",
        shapes,
        "-o",
        model,
        "--preset",
        "paper-hks",
        "--steps",
        600,
        "--include",
        "*[0-2]0",
    )
    done = run(
        "match",
        shapes / "tr_reg_000.off",
        shapes / "tr_reg_030.off",
        "-o",
        output,
        "-m",
        model,
        "--json",
    )
    summary = json.loads(done.stdout)
    assert summary["matched"] == 384
    rows = output.read_text().splitlines()
    assert rows[0] == "source,target,distance,confidence"
    assert len(rows) == 385
    pairs = tmp_path / "pairs.tsv"
    pairs.write_text("tr_reg_000\ttr_reg_030\n")
    trained = json.loads(
        run("evaluate", shapes, "--model", model, "--pairs", pairs, "--no-refine", "--json").stdout
    )
    assert trained["pairs"] == 1
    everything = json.loads(run("evaluate", shapes, "--model", "wks", "--json").stdout)
    assert everything["pairs"] == 12
    promised = (
        "mean_geodesic_error_x100 median_geodesic_error_x100 accuracy_5pct_diameter auc coverage"
    )
    assert {*promised.split(), "pairs", "seconds"} <= set(trained)
    assert "600 steps" in run("model", "show", model).stdout
    assert "hks (raw descriptor)" in run("model", "list").stdout


def test_several_models_are_compared_in_one_figure(shapes, tmp_path):
    model, plot = tmp_path / "metric", tmp_path / "curves.png"
    done = run("train", shapes, "-o", model, "--preset", "osd", "--include", "*[0-2]0")
    assert "trained 400 steps on 3 shapes" in done.stdout
    arguments = ("evaluate", shapes, "--include", "*[23]0", "-m", model, "-m", "hks")
    found = json.loads(run(*arguments, "--plot", plot, "--json").stdout)
    assert list(found) == ["models"]
    assert [each["model"] for each in found["models"]] == ["metric", "hks"]
    alone = json.loads(run(*arguments[:4], "-m", "hks", "--json").stdout)
    for key in ("data", "pairs", "auc", "mean_geodesic_error_x100"):
        assert alone[key] == found["models"][1][key]
    assert plot.stat().st_size > 10_000
    lines = run(*arguments, "--plot", plot, "--force").stdout.splitlines()
    assert lines[1].split() == ["model", "metric", "hks"]
    assert lines[-1] == f"drawn to {plot}"
    assert "--force" in run(*arguments, "--plot", plot, expect=1).stderr
    assert ".png, .pdf or .svg" in run(*arguments, "--plot", tmp_path / "a.txt", expect=1).stderr
    within = run(*arguments, "--plot", plot / "a.png", expect=1).stderr
    assert "is a file, not a folder" in within


def test_spectrum_descriptor_and_cache(shapes, tmp_path):
    mesh = shapes / "tr_reg_000.off"
    run("spectrum", mesh, "-k", 20, "-o", tmp_path / "s.npz")
    with np.load(tmp_path / "s.npz", allow_pickle=False) as file:
        assert file["eigenvalues"].shape == (20,)
    run("spectrum", mesh, "-k", 20, "--coarse", 350, "-o", tmp_path / "c.npz")
    with np.load(tmp_path / "c.npz", allow_pickle=False) as file:
        assert file["eigenvectors"].shape == (384, 20)
    for kind, width in (("hks", 100), ("gps", 25), ("sihks", 19), ("geometry", 150)):
        run("descriptor", mesh, "--kind", kind, "-o", tmp_path / f"{kind}.npy")
        assert np.load(tmp_path / f"{kind}.npy").shape == (384, width)
    run("descriptor", mesh, "-o", tmp_path / "d.csv")
    assert len((tmp_path / "d.csv").read_text().splitlines()) == 384
    assert "entries" in run("cache").stdout
    assert " 0 entries" in run("cache", "--clear").stdout


def test_bad_input_ends_with_one_line_and_leaves_nothing(shapes, tmp_path):
    good = shapes / "tr_reg_000.off"
    bad = tmp_path / "bad"
    bad.mkdir()
    (bad / "empty.off").write_text("")
    (bad / "nan.off").write_text("OFF\n3 1 0\n0 0 0\n1 0 nan\n0 1 0\n3 0 1 2\n")
    (bad / "range.off").write_text("OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 7\n")
    (bad / "three.off").write_text("OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n")
    write_mesh(icosphere(1), bad / "small.off")
    output = tmp_path / "out"
    output.mkdir()
    for name in ("missing", "empty", "nan", "range", "three", "small"):
        done = run(
            "match", bad / f"{name}.off", good, "-m", "hks", "-o", output / "m.csv", expect=1
        )
        assert done.stderr.count("\n") == 1, done.stderr
        assert done.stderr.startswith("esd: ")
    for arguments in (
        ("spectrum", good, "-k", 5000, "-o", output / "s.npz"),
        ("spectrum", good, "-o", output / "s.txt"),
        ("descriptor", good, "--kind", "abc", "-o", output / "d.npy"),
        ("match", good, good, "-m", "nosuch", "-o", output / "m.csv"),
        ("match", good, good, "-m", "hks", "-o", output / "m.xml"),
        ("match", good, good, "-m", "hks", "-o", good / "m.csv"),
        ("match", good, good, "-m", "hks", "--reject", "-o", output / "m.csv"),
        ("evaluate", bad / "none", "-m", "hks"),
        ("evaluate", shapes, "-m", "hks", "--include", "nothing"),
        ("train", shapes, "-o", output / "m", "--preset", "nosuch"),
        ("train", shapes, "-o", good, "--preset", "paper-hks"),
        ("train", shapes, "-o", output / "m", "--preset", "paper-hks", "--include", "tr_reg_000"),
    ):
        done = run(*arguments, expect=1)
        assert done.stderr.count("\n") == 1, done.stderr
    assert files(output) == set()


def test_a_map_by_way_of_coarse_copies(shapes, tmp_path):
    pair = (shapes / "tr_reg_000.off", shapes / "tr_reg_030.off", "-m", "hks", "--coarse", 350)
    printed = json.loads(run("match", *pair, "-o", tmp_path / "m.npy", "--json").stdout)
    assert printed["matched"] == len(np.load(tmp_path / "m.npy")) == 384
    refused = run("match", *pair, "--one-to-one", "-o", tmp_path / "n.npy", expect=2)
    assert "--one-to-one or --coarse, not both" in refused.stderr


def test_wrong_usage_ends_with_two(shapes):
    run("match", shapes, expect=2)
    run("nosuch", expect=2)
    run("spectrum", shapes / "tr_reg_000.off", "-k", "many", "-o", "x.npz", expect=2)


def test_help_and_version_load_nothing_heavy():
    run("--version")
    code = (
        "import sys; from esd.cli.app import app\n"
        "heavy = {'scipy', 'torch', 'trimesh', 'matplotlib', 'h5py'} & set(sys.modules)\n"
        "sys.exit(str(heavy) if heavy else 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_experiments_write_reports_and_go_on(shapes, tmp_path):
    arguments = ("reproduce", "dimension", "--data", shapes, "-o", tmp_path / "r", "--quick")
    assert "report.md" in run(*arguments).stdout
    folder = tmp_path / "r" / "dimension"
    assert {"report.md", "components.csv", "dimension.png", "dimension.pdf"} <= files(folder)
    text = (folder / "report.md").read_text()
    assert f"esd reproduce dimension --data {shapes}" in text
    assert "2 shapes of 00, 01" in text
    assert "once" in run(*arguments, "--data", "bodies", expect=2).stderr
    run("reproduce", "nosuch", "--data", shapes, "-o", tmp_path / "r", expect=2)
    assert "--force" in run(*arguments, expect=1).stderr
    assert "is left without" in run(*arguments, "--test", "*", "--force", expect=1).stderr


def test_sequences_are_listed_and_selected(tmp_path):
    source, selection = tmp_path / "dyna", tmp_path / "selection.hdf5"
    mesh = torus(6, 5)
    with h5py.File(source, "w") as file:
        file["faces"] = mesh.faces
        file["50002_hips"] = np.repeat(mesh.vertices[:, :, None], 30, axis=2)
    assert run("data", "list", source).stdout == "50002\thips\t30\n"
    assert "4 frames" in run("data", "select", source, "-o", selection, "--per-subject", 4).stdout
    assert run("data", "list", selection).stdout == "50002\thips\t4\n"


def test_a_batch_of_pairs(shapes, tmp_path):
    pairs = shapes / "pairs.csv"
    pairs.write_text("source,target\ntr_reg_000.off,tr_reg_010.off\ntr_reg_010.off,no.off\n")
    done = run("batch", pairs, "-m", "hks", "-o", tmp_path, "--workers", 2, expect=1)
    assert "no.off" in done.stdout
    assert "1 of 2 pairs matched" in done.stdout
    assert done.stderr == "esd: 1 of 2 pairs failed; the other maps are written.\n"
    assert len((tmp_path / "tr_reg_000-tr_reg_010.csv").read_text().splitlines()) == 385
    assert "--force" in run("batch", pairs, "-o", tmp_path, expect=1).stderr
    run("batch", pairs, "--view", expect=2)
    run("match", "a.off", "b.off", "--scheduler", "tcp://x", expect=2)


def test_landmarks_in_two_files_or_in_one_of_pairs(shapes, tmp_path):
    source, target = shapes / "tr_reg_000.off", shapes / "tr_reg_010.off"
    places = [0, 50, 150, 250, 350]
    for name in ("a.csv", "b.csv"):
        lines = [f"p{i},{vertex}" for i, vertex in enumerate(places)]
        (tmp_path / name).write_text("\n".join(["name,vertex", *lines, ""]))
    (tmp_path / "pairs.csv").write_text("\n".join(["source,target", *(f"{i},{i}" for i in places)]))
    files = [tmp_path / "a.csv", tmp_path / "b.csv"]
    arguments = ["match", source, target, "-o", tmp_path / "m.npy", "--json", "--force"]
    for landmarks in (files, [tmp_path / "pairs.csv"]):
        summary = json.loads(run(*arguments, "--landmarks", *landmarks).stdout)
        assert summary["landmarks"] == 5
        assert summary["candidate"].startswith("landmarks+")
        found = np.load(tmp_path / "m.npy")
        gap = np.linalg.norm(np.diff(np.stack([found[places], places]), axis=0), axis=0)
        assert (gap < 48).all()  # two rings of the torus, whose vertices number 24 by 16
    (tmp_path / "few.csv").write_text("name,vertex\np0,0\np1,50\n")
    failed = run(*arguments, "--landmarks", files[0], tmp_path / "few.csv", expect=1)
    assert "3 landmarks or more must have a name that both files have; got 2" in failed.stderr
    run(*arguments, "--landmarks", *files, files[0], expect=2)
