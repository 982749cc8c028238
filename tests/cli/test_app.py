import os
import re
import subprocess
import sys

import pytest

from command import run
from esd.cli import main
from esd.descriptors.recipe import DESCRIPTOR_KINDS
from esd.learning.model import bundled_models
from esd.learning.presets import PRESETS


def in_a_process(*arguments: str, **variables: str) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, **variables}
    command = [sys.executable, "-m", "esd", *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=False, env=environment)


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


def test_how_much_is_reported(run_here, pair):
    export = ("export", "a.off", "b.off", "map.csv", "--force", "-o", "n.npy")
    assert run_here(*export, where=pair).stdout == "written to n.npy\n"
    quiet = run_here(*export, "--quiet", where=pair)
    assert (quiet.stdout, quiet.stderr) == ("", "")


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


@pytest.mark.parametrize(
    ("command", "names"),
    [
        ("match", (*bundled_models(), *DESCRIPTOR_KINDS)),
        ("evaluate", (*bundled_models(), *DESCRIPTOR_KINDS)),
        ("descriptor", DESCRIPTOR_KINDS),
        ("train", tuple(PRESETS)),
        ("precompute", tuple(PRESETS)),
    ],
)
def test_help_lists_what_the_package_holds(command, names, monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", "1000")
    monkeypatch.setattr(sys, "argv", ["esd", command, "-h"])
    with pytest.raises(SystemExit) as ended:
        main()
    assert not ended.value.code
    text = capsys.readouterr().out
    assert {name for name in names if not re.search(rf"\b{re.escape(name)}\b", text)} == set()
    assert not re.search(r"\{(models|presets|descriptors)\}", text)
