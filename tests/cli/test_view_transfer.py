import json
import logging
import os
import re
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from esd.cli import main
from esd.matching.correspondence import Correspondence, load_map, save_map
from esd.mesh.io.meshes import read_arrays, read_mesh, write_mesh
from esd.mesh.mesh import Mesh
from esd.mesh.shapes import subdivide, torus


@pytest.fixture
def run(capsys, monkeypatch):
    """Run a command in this process, which saves the time of a start."""

    def run_command(*arguments: object, expect: int = 0, where: Path) -> SimpleNamespace:
        monkeypatch.chdir(where)
        monkeypatch.setattr(sys, "argv", ["esd", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            main()
            raise SystemExit(0)
        logging.getLogger().setLevel(logging.WARNING)
        stdout, stderr = capsys.readouterr()
        assert (ended.value.code or 0) == expect, stderr
        return SimpleNamespace(stdout=stdout, stderr=stderr)

    return run_command


@pytest.fixture
def pair(tmp_path) -> Path:
    """A torus, the same with four times the faces, and the map between them."""
    source = torus(12, 8)
    target = subdivide(source)
    write_mesh(source, tmp_path / "a.off")
    write_mesh(Mesh(target.vertices * [1, 1, 2], target.faces), tmp_path / "b.off")
    count = len(source.vertices)
    match = Correspondence(np.arange(count), np.zeros(count), np.ones(count))
    save_map(match, tmp_path / "map.csv")
    vertices = "\n".join(map(str, range(1, count + 1)))
    for name in "ab":
        (tmp_path / f"{name}.vts").write_text(vertices)
    return tmp_path


def test_view_writes_a_page_with_the_error(run, pair):
    run("view", "a.off", "b.off", "map.csv", where=pair)
    assert '["error", "f4"' not in (pair / "a-b.html").read_text()
    run("view", "a.off", "b.off", "map.csv", "--truth", "map.csv", "-o", "t.html", where=pair)
    points = ("--points", "a.vts", "b.vts")
    run("view", "a.off", "b.off", "map.csv", *points, "-o", "p.html", where=pair)
    assert (pair / "t.html").read_text() == (pair / "p.html").read_text()
    assert '["error", "f4"' in (pair / "p.html").read_text()
    done = run("view", "a.off", "b.off", "map.csv", *points, "--truth", "map.csv", "-o", "q.html", where=pair, expect=2)  # fmt: skip
    assert "--truth or --points, not both" in done.stderr
    (pair / "b.vts").write_text("1\n2\n")
    done = run("view", "a.off", "b.off", "map.csv", *points, "-o", "q.html", where=pair, expect=1)
    assert "must have the same points; one has 96" in done.stderr


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux has such names")
def test_names_that_are_no_text_are_shown(run, pair):
    odd = os.fsdecode(b"a\xff.off")
    (pair / odd).write_bytes((pair / "a.off").read_bytes())
    run("view", odd, "b.off", "map.csv", "-o", "odd.html", where=pair)
    assert "a\N{REPLACEMENT CHARACTER}.off" in (pair / "odd.html").read_text()


def test_export_keeps_matches_and_changes_formats(run, pair):
    run("export", "a.off", "b.off", "map.csv", "--truth", "map.csv", "-o", "a.ply", where=pair)
    assert b"property int target\n" in (pair / "a.ply").read_bytes()
    assert b"property float error\n" in (pair / "a.ply").read_bytes()
    run("export", "a.off", "b.off", "map.csv", "-o", "m.vts", where=pair)
    match = load_map(pair / "m.vts", source_count=96, target_count=384)
    np.testing.assert_array_equal(match.target_index, np.arange(96))


def test_points_are_exported_and_take_labels(run, pair):
    np.savetxt(pair / "p.xyz", read_mesh(pair / "a.off").vertices)
    for name in ("p.ply", "p.vtp", "p.npy"):
        run("export", "p.xyz", "b.off", "map.csv", "-o", name, where=pair)
    assert b"property int target\n" in (pair / "p.ply").read_bytes()
    assert len(read_arrays(pair / "p.ply")[0]) == 96
    (pair / "labels.txt").write_text("one\n" * 96)
    run("transfer", "p.xyz", "b.off", "map.csv", "--labels", "labels.txt", where=pair)
    assert (pair / "b-labels.txt").read_text() == "one\n" * 384
    truth = ("--truth", "map.csv", "-o", "e.ply")
    done = run("export", "b.off", "p.xyz", "map.csv", *truth, where=pair, expect=1)
    assert "maps 96 vertices" in done.stderr
    done = run("export", "a.off", "p.xyz", "map.csv", *truth, where=pair, expect=1)
    assert "Errors are measured along the faces of the target" in done.stderr


def test_transfer_of_what_people_have(run, pair):
    common = ("a.off", "b.off", "map.csv")
    target = read_mesh(pair / "b.off")
    (pair / "labels.txt").write_text("one\n" * 96)
    run("transfer", *common, "--labels", "labels.txt", where=pair)
    assert (pair / "b-labels.txt").read_text() == "one\n" * len(target.vertices)
    np.save(pair / "faces.npy", np.arange(192))
    run("transfer", *common, "--labels", "faces.npy", "-o", "f.npy", where=pair)
    assert np.load(pair / "f.npy").shape == (len(target.faces),)
    np.savetxt(pair / "values.txt", target.vertices[:96, 0])
    run("transfer", *common, "--values", "values.txt", "--method", "nearest", where=pair)
    assert set(np.loadtxt(pair / "b-values.txt").round(6)) <= set(target.vertices[:96, 0].round(6))
    (pair / "points.csv").write_text("name,vertex\nnose,5\n")
    run("transfer", *common, "--landmarks", "points.csv", where=pair)
    assert (pair / "b-landmarks.csv").read_text().splitlines()[1].startswith("nose,5,")
    run("transfer", *common, "--morph", 3, where=pair)
    last = read_mesh(pair / "b-morph" / "2.ply")
    assert len(last.vertices) == 96
    done = run("transfer", *common, where=pair, expect=2)
    assert "Give one of --texture" in done.stderr
    done = run("transfer", *common, "--texture", where=pair, expect=1)
    assert "textures are read from .obj, .glb" in done.stderr


def test_colours_and_texture_are_carried(run, pair):
    pytest.importorskip("PIL", reason="pillow is not installed")
    from PIL import Image

    from esd.mesh.io.attributes import read_vertex_colours, write_coloured
    from esd.mesh.io.textures import Texture, read_texture, write_textured

    mesh = read_mesh(pair / "a.off")
    write_coloured(mesh, np.full((96, 4), 200, dtype=np.uint8), pair / "a.ply")
    run("transfer", "a.ply", "b.off", "map.csv", "--vertex-colors", where=pair)
    assert set(read_vertex_colours(pair / "b-colours.ply").ravel()) == {200}
    coordinates = np.full((192, 3, 2), 0.5)
    write_textured(mesh, Texture(coordinates, Image.new("RGB", (4, 4), "red")), pair / "t.obj")
    run("transfer", "t.obj", "b.off", "map.csv", "--texture", where=pair)
    carried = read_texture(pair / "b-texture.obj")
    np.testing.assert_allclose(carried.coordinates, 0.5)
    assert carried.image.getpixel((0, 0)) == (255, 0, 0)


def test_nothing_is_overwritten_unless_forced(run, pair):
    common = ("a.off", "b.off", "map.csv")
    before = (pair / "a.vts").read_text()
    for arguments in (
        ("export", *common, "-o", "a.vts"),
        ("spectrum", "a.off", "-k", 5, "-o", "a.npz"),
        ("descriptor", "a.off", "-o", "a.npz"),
        ("match", "a.off", "b.off", "-o", "map.csv"),
        ("match", "a.off", "b.off", "--view"),
        ("train", "bodies", "--preset", "paper-hks", "-o", "model"),
        ("data", "bodies", "--export", "set"),
    ):
        (pair / "a.npz").write_bytes(b"x")
        (pair / "a-b.html").write_bytes(b"x")
        (pair / "model").mkdir(exist_ok=True)
        for name in ("config.json", "model.safetensors"):
            (pair / "model" / name).write_text("x")
        (pair / "set" / "shapes").mkdir(parents=True, exist_ok=True)
        (pair / "set" / "shapes" / "x.off").write_text("x")
        done = run(*arguments, where=pair, expect=1)
        assert "exists; choose another name, or give --force" in done.stderr
        assert done.stderr.count("\n") == 1
    assert (pair / "a.vts").read_text() == before
    (pair / "empty.npz").touch()  # nothing to lose
    run("spectrum", "a.off", "-k", 5, "-o", "empty.npz", where=pair)
    run("spectrum", "a.off", "-k", 5, "-o", "a.npz", "--force", where=pair)
    run("spectrum", "a.off", "-k", 5, where=pair)
    assert (pair / "a-spectrum.npz").is_file()
    assert not (pair / "a-b.csv").exists()


def test_match_writes_a_page_beside_its_map(run, tmp_path, monkeypatch):
    big = torus(24, 16)
    write_mesh(big, tmp_path / "a.off")
    arguments = ("match", "a.off", "a.off", "-m", "hks", "--view", "--json")
    opened = []
    monkeypatch.setattr("typer.launch", opened.append)
    done = run(*arguments, where=tmp_path)
    assert opened == [str(tmp_path / "a-a.html")]
    assert json.loads(done.stdout)["matched"] == 384
    assert (tmp_path / "a-a.csv").is_file()
    assert (tmp_path / "a-a.html").stat().st_size > 500_000


def test_broken_meshes_are_shown_with_the_vertices_of_their_files(run, tmp_path, monkeypatch):
    monkeypatch.setattr("typer.launch", lambda page: None)
    whole = torus(24, 16)
    write_mesh(whole, tmp_path / "a.off")
    lines = (tmp_path / "a.off").read_text().splitlines()
    lines[5] = "nan 0 0"
    (tmp_path / "b.off").write_text("\n".join(lines))
    run("match", "b.off", "a.off", "-m", "hks", "--view", where=tmp_path)
    run("view", "b.off", "a.off", "b-a.csv", "-o", "again.html", where=tmp_path)
    for name in ("b-a.html", "again.html"):
        layout = re.search(r'"arrays": (\[\[.*?\]\])', (tmp_path / name).read_text())
        assert {array: size for array, _, _, size in json.loads(layout[1])}["map"] == 384
    (tmp_path / "points.xyz").write_text("\n".join(" ".join(map(str, v)) for v in whole.vertices))
    done = run("match", "points.xyz", "a.off", "-m", "hks", "--view", where=tmp_path, expect=1)
    assert "There is no face between finite vertices; a surface is needed" in done.stderr
    assert not (tmp_path / "points-a.csv").exists()


def test_how_much_is_reported(run, pair):
    export = ("export", "a.off", "b.off", "map.csv", "--force", "-o", "n.npy")
    assert run(*export, where=pair).stdout == "written to n.npy\n"
    quiet = run(*export, "--quiet", where=pair)
    assert (quiet.stdout, quiet.stderr) == ("", "")


def in_a_process(*arguments: str, **variables: str) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, **variables}
    command = [sys.executable, "-m", "esd", *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=False, env=environment)


def test_verbose_says_what_is_done_and_shows_where_only_faults_of_esd_happened(pair):
    mesh, output = str(pair / "a.off"), str(pair / "s.npz")
    loud = in_a_process("spectrum", mesh, "-k", "5", "-o", output, "--verbose", ESD_CACHE="off")
    assert "5 eigenpairs of 96 vertices were computed in" in loud.stderr
    failed = in_a_process("spectrum", "missing.off", "--verbose")
    assert failed.returncode == 1
    assert failed.stderr == "esd: There is no file 'missing.off'.\n"
    code = "import sys, esd.cli.app as a; a.app = lambda args: [][1]; sys.argv = ['esd']; a.main()"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert "IndexError: list index out of range. This is a fault of esd" in done.stderr
    assert "Traceback" not in done.stderr


def test_help_has_examples_and_no_colour_where_none_is_wanted():
    colours = {"FORCE_COLOR": "1", "TERM": "xterm"}
    assert re.search(r"\x1b\[[\d;]*3\dm", in_a_process("match", "--help", **colours).stdout)
    text = in_a_process("match", "--help", NO_COLOR="1", **colours).stdout
    assert "\x1b[3" not in text
    assert "esd match a.ply b.ply" in text
    assert "--install-completion" in in_a_process("--help").stdout
