import os

import pytest

from esd.cli.output import destination
from esd.common import InputError


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


def test_nothing_is_overwritten_unless_forced(run_here, pair):
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
        done = run_here(*arguments, where=pair, expect=1)
        assert "exists; choose another name, or give --force" in done.stderr
        assert done.stderr.count("\n") == 1
    assert (pair / "a.vts").read_text() == before
    (pair / "empty.npz").touch()  # nothing to lose
    run_here("spectrum", "a.off", "-k", 5, "-o", "empty.npz", where=pair)
    run_here("spectrum", "a.off", "-k", 5, "-o", "a.npz", "--force", where=pair)
    run_here("spectrum", "a.off", "-k", 5, where=pair)
    assert (pair / "a-spectrum.npz").is_file()
    assert not (pair / "a-b.csv").exists()
