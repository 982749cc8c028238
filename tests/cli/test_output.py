import os
import re
import sys
import time

import pytest

import esd.cli.progress as progress
from esd.cli import main
from esd.cli.output import destination
from esd.common import InputError
from esd.descriptors.recipe import DESCRIPTOR_KINDS
from esd.learning.model import bundled_models
from esd.learning.presets import PRESETS


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


def test_where_there_is_no_terminal_progress_is_a_line_now_and_then(monkeypatch, capsys):
    monkeypatch.setattr(progress, "SILENCE", 0.05)
    with progress.progress("counting", 3) as advance:
        advance(2)
        time.sleep(0.2)
    with progress.progress("waiting"):
        time.sleep(0.2)
    lines = capsys.readouterr().err.splitlines()
    assert lines[0] == "esd: counting: 2 of 3, 0 s"
    assert lines[-1] == "esd: waiting: 0 s"


def test_destinations(tmp_path):
    file, folder = tmp_path / "f.txt", tmp_path / "d"
    file.write_text("x")
    folder.mkdir()
    with pytest.raises(InputError, match="is a folder; give the name of a file"):
        destination(folder, force=True)
    with pytest.raises(InputError, match="is a file; give the name of a folder"):
        destination(file, force=True, is_folder=True)
    with pytest.raises(InputError, match="exists; choose another name"):
        destination(file, force=False)
    with pytest.raises(InputError, match="is read by this command"):
        destination(tmp_path / "d" / ".." / "f.txt", force=True, inputs=[file])
    assert destination(file, force=True) == file
    assert destination(folder, force=False, is_folder=True) == folder
    missing = tmp_path / "none.txt"
    with pytest.raises(InputError, match="is read by this command"):
        destination(missing, force=True, inputs=[os.path.relpath(missing)])
