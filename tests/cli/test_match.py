import json
import os
import re
from pathlib import Path

import numpy as np

from esd.datasets.bodies import bodies
from esd.datasets.parts import part_of
from esd.mesh.io.meshes import write_mesh
from esd.mesh.mesh import Mesh
from esd.mesh.shapes import icosphere, torus


def files(folder: Path) -> set[str]:
    return {name for _, _, names in os.walk(folder) for name in names}


def test_bad_input_ends_with_one_line_and_leaves_nothing(run, shapes, tmp_path):
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


def test_a_map_by_way_of_coarse_copies(run, shapes, tmp_path):
    pair = (shapes / "tr_reg_000.off", shapes / "tr_reg_030.off", "-m", "hks", "--coarse", 350)
    printed = json.loads(run("match", *pair, "-o", tmp_path / "m.npy", "--json").stdout)
    assert printed["matched"] == len(np.load(tmp_path / "m.npy")) == 384
    refused = run("match", *pair, "--one-to-one", "-o", tmp_path / "n.npy", expect=2)
    assert "--one-to-one or --coarse, not both" in refused.stderr


def test_landmarks_in_two_files_or_in_one_of_pairs(run, shapes, tmp_path):
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


def test_match_writes_a_page_beside_its_map(run_here, tmp_path, monkeypatch):
    big = torus(24, 16)
    write_mesh(big, tmp_path / "a.off")
    arguments = ("match", "a.off", "a.off", "-m", "hks", "--view", "--json")
    opened = []
    monkeypatch.setattr("typer.launch", opened.append)
    done = run_here(*arguments, where=tmp_path)
    assert opened == [str(tmp_path / "a-a.html")]
    assert json.loads(done.stdout)["matched"] == 384
    assert (tmp_path / "a-a.csv").is_file()
    assert (tmp_path / "a-a.html").stat().st_size > 500_000


def test_broken_meshes_are_shown_with_the_vertices_of_their_files(run_here, tmp_path, monkeypatch):
    monkeypatch.setattr("typer.launch", lambda page: None)
    whole = torus(24, 16)
    write_mesh(whole, tmp_path / "a.off")
    lines = (tmp_path / "a.off").read_text().splitlines()
    lines[5] = "nan 0 0"
    (tmp_path / "b.off").write_text("\n".join(lines))
    run_here("match", "b.off", "a.off", "-m", "hks", "--view", where=tmp_path)
    run_here("view", "b.off", "a.off", "b-a.csv", "-o", "again.html", where=tmp_path)
    for name in ("b-a.html", "again.html"):
        layout = re.search(r'"arrays": (\[\[.*?\]\])', (tmp_path / name).read_text())
        assert {array: size for array, _, _, size in json.loads(layout[1])}["map"] == 384
    (tmp_path / "points.xyz").write_text("\n".join(" ".join(map(str, v)) for v in whole.vertices))
    run_here("match", "points.xyz", "a.off", "-m", "hks", "--view", where=tmp_path)
    layout = re.search(r'"arrays": (\[\[.*?\]\])', (tmp_path / "points-a.html").read_text())
    sizes = {array: size for array, _, _, size in json.loads(layout[1])}
    assert sizes["source_faces"] > 0.7 * 2 * 3 * 384  # triangles between the points
    (tmp_path / "line.xyz").write_text("".join(f"{i} {i} {i}\n" for i in range(400)))
    done = run_here(
        "view", "line.xyz", "a.off", "b-a.csv", "-o", "l.html", where=tmp_path, expect=1
    )
    assert "'line.xyz': No surface can be seen between the points" in done.stderr


def test_parts_are_matched_at_the_scale_asked_for(run, tmp_path):
    by_name = {shape.name: shape for shape in bodies(vertex_count=2500).shapes}
    whole = by_name["s11_p02"].mesh()
    part = part_of(by_name["s10_p01"].mesh(), "cut of 35 %", seed=3).mesh
    write_mesh(whole, tmp_path / "whole.ply")
    write_mesh(Mesh(1000 * part.vertices, part.faces), tmp_path / "part.ply")
    files = tmp_path / "whole.ply", tmp_path / "part.ply"
    options = "-o", tmp_path / "m.npy", "--candidates", "part", "--scale", "free"
    done = run("match", *files, *options, "--json")
    found = json.loads(done.stdout)
    assert found["candidate"] == "part"
    assert 0.0007 < found["overlap"]["scale"] < 0.0014
    assert 0.4 < found["overlap"]["source"] < 0.9
    assert found["matched"] == (np.load(tmp_path / "m.npy") >= 0).sum() < len(whole.vertices)
    run("match", *files, "--scale", "wide", expect=2)
