import io
import os
import re
import signal
import struct
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import esd.common as common
from esd.common import (
    InputError,
    check_can_be_made,
    existing_file,
    install_hint,
    number_lines,
    read_array,
    reason,
    table_rows,
    whole_file,
    whole_folder,
    whole_number,
)

ROOT = Path(__file__).parents[1]


def test_a_file_keeps_its_permissions_and_its_link(tmp_path):
    secret, link = tmp_path / "secret.txt", tmp_path / "link.txt"
    secret.write_text("old")
    secret.chmod(0o600)
    link.symlink_to(secret)
    with whole_file(link) as temporary:
        temporary.write_text("new")
    assert link.is_symlink()
    assert secret.read_text() == "new"
    assert secret.stat().st_mode & 0o777 == 0o600
    before = os.umask(0o027)
    try:
        with whole_file(tmp_path / "a" / "b" / "fresh.txt") as temporary:
            temporary.write_text("new")
    finally:
        os.umask(before)
    assert (tmp_path / "a" / "b" / "fresh.txt").stat().st_mode & 0o777 == 0o640


def test_what_fails_leaves_the_old_file_and_the_old_folder(tmp_path):
    file, folder = tmp_path / "f.txt", tmp_path / "d"
    file.write_text("old")
    folder.mkdir()
    (folder / "old").touch()
    with pytest.raises(KeyError), whole_file(file) as temporary:
        temporary.write_text("half")
        raise KeyError
    with pytest.raises(KeyError), whole_folder(folder) as temporary:
        (temporary / "half").touch()
        raise KeyError
    assert file.read_text() == "old"
    assert [path.name for path in folder.iterdir()] == ["old"]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["d", "f.txt"]


@pytest.mark.parametrize("can_exchange", [True, False])
def test_a_folder_is_replaced_whole(tmp_path, monkeypatch, can_exchange):
    if not can_exchange:
        monkeypatch.setattr(common, "_exchanged", lambda first, second: False)
    folder = tmp_path / "a" / "d"
    for name in ("first", "second"):
        with whole_folder(folder) as temporary:
            (temporary / name).touch()
        assert [path.name for path in folder.iterdir()] == [name]
    assert [path.name for path in folder.parent.iterdir()] == ["d"]


def test_a_folder_is_exchanged_in_one_step(tmp_path):
    if not sys.platform.startswith("linux"):
        pytest.skip("only Linux exchanges folders")
    for name in ("a", "b"):
        (tmp_path / name / name).mkdir(parents=True)
    assert common._exchanged(tmp_path / "a", tmp_path / "b")
    assert (tmp_path / "a" / "b").is_dir()
    assert (tmp_path / "b" / "a").is_dir()


@pytest.mark.skipif(sys.platform == "win32", reason="there is no SIGKILL on Windows")
def test_killed_while_writing_a_folder_the_old_one_stays(tmp_path):
    folder = tmp_path / "d"
    folder.mkdir()
    (folder / "old").touch()
    code = (
        "import os, signal, sys; from esd.common import whole_folder\n"
        "with whole_folder(sys.argv[1]) as t:\n"
        "    (t / 'half').touch(); os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    done = subprocess.run([sys.executable, "-c", code, str(folder)], check=False)
    assert done.returncode == -signal.SIGKILL
    assert [path.name for path in folder.iterdir()] == ["old"]


def test_paths_that_cannot_be_written_are_refused(tmp_path):
    file = tmp_path / "f.txt"
    file.touch()
    for write in (whole_file, whole_folder):
        with pytest.raises(InputError, match="cannot be written"), write(file / "x.txt"):
            pass
    for write, path, message in (
        (whole_file, tmp_path, "is a folder; give the name of a file"),
        (whole_folder, file, "is a file; give the name of a folder"),
    ):
        with pytest.raises(InputError, match=message), write(path):
            pass
    with pytest.raises(InputError, match="is a file, not a folder"):
        check_can_be_made(file / "a" / "x.txt")
    assert check_can_be_made(tmp_path / "a" / "b" / "x.txt").name == "x.txt"
    assert not (tmp_path / "a").exists()


@pytest.mark.skipif(not Path("/proc").is_dir(), reason="needs a folder no one can write to")
def test_a_folder_that_cannot_be_written_to_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"'/proc/a/x.txt' cannot be written: in '/proc', \w+"):
        check_can_be_made("/proc/a/x.txt")  # though its permissions allow it to root
    check_can_be_made(tmp_path / "x.txt")
    assert not list(tmp_path.iterdir())


def test_whole_numbers_are_read_and_others_refused():
    assert [whole_number(text) for text in (" 7", "-1\n", "0")] == [7, -1, 0]
    for text, said in (("", "empty"), (None, "empty"), ("1.5", "'1.5'"), ("--1", "'--1'")):
        with pytest.raises(InputError, match=f"expected a whole number; .*{said}"):
            whole_number(text)
    with pytest.raises(InputError, match="expected a whole number; got '1000"):
        whole_number(str(10**18))


def test_reasons_are_in_plain_words():
    objects, said = io.BytesIO(), []
    np.save(objects, np.array([None]), allow_pickle=True)
    objects.seek(0)
    for parse in (
        lambda: int("x y"),
        lambda: int(b"x"),
        lambda: float("zero"),
        lambda: np.loadtxt(["1 one"]),
        lambda: b"a\xff".decode(),
        lambda: int("1" * 5000),
        lambda: np.load(io.BytesIO(b"hello")),
        lambda: np.load(objects),
    ):
        with pytest.raises(ValueError, match=r"\w") as raised:
            parse()
        said.append(reason(raised.value))
    assert said == [
        "expected a whole number; got 'x y'",
        "expected a whole number; got 'x'",
        "expected a number; got 'zero'",
        "expected a number; got 'one' at row 0, column 2",
        "byte 2 of it is no text in UTF-8",
        "a whole number is too long",
        "it is no .npy file",
        "it holds Python objects, which are not loaded, since they can run code",
    ]
    for error, words in (
        (OverflowError("Python int too large to convert to C long"), "beyond 64 bits"),
        (RecursionError("maximum recursion depth exceeded in comparison"), "nested too deeply"),
        (struct.error("unpack_from requires a buffer of at least 20 bytes"), "it is cut short"),
    ):
        assert words in reason(error)


def test_files_that_cannot_be_there_are_missing(tmp_path):
    for name in ("none", "x" * 300, "a\0b"):
        with pytest.raises(InputError, match="There is no file"):
            existing_file(tmp_path / name)
    (tmp_path / "a.npy").write_bytes(b"hello")
    with pytest.raises(InputError, match=r"a.npy' holds no array"):
        read_array(tmp_path / "a.npy")
    with (tmp_path / "a.npy").open("wb") as file:
        np.savez(file, a=np.zeros(3))
    with pytest.raises(InputError, match=r"a.npy' holds no array: it is an archive"):
        read_array(tmp_path / "a.npy")


def test_hints_name_the_distribution_and_an_extra_that_it_has():
    tomllib = pytest.importorskip("tomllib", reason="tomllib came with Python 3.11")
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert install_hint("train") == f"pip install '{project['name']}[train]'"
    used = {
        extra
        for file in (ROOT / "src").rglob("*.py")
        for extra in re.findall(r"install_hint\(['\"](\w+)['\"]\)", file.read_text())
    }
    assert used
    assert used <= set(project["optional-dependencies"])


def test_no_page_tells_to_install_the_other_package_called_esd():
    texts = [*(ROOT / "src").rglob("*.py"), *(ROOT / "docs").rglob("*.md"), ROOT / "README.md"]
    wrong = re.compile(r"pip install '?esd\b")
    assert [str(file) for file in texts if wrong.search(file.read_text())] == []


def test_tables_are_read_as_spreadsheets_write_them():
    for text in (
        "name,x\nnose,1\n\near, 2 \n",
        '"Name";"X"\r\nnose;1\r\n\r\near;2\r\n',
        " name\tX \nnose\t1\t7\n\near\t2\n",
    ):
        columns, rows = table_rows(text)
        found = list(rows)
        assert columns == {"name", "x"}
        assert found == [(2, {"name": "nose", "x": "1"}), (4, {"name": "ear", "x": "2"})]
    columns, rows = table_rows("a,b,c\n1\n")
    assert list(rows) == [(2, {"a": "1", "b": "", "c": ""})]
    assert columns == {"a", "b", "c"}
    columns, rows = table_rows("")
    assert (columns, list(rows)) == (frozenset(), [])


@pytest.mark.parametrize(
    ("text", "lines", "between"),
    [
        ("", [], None),
        ("1 2\n\n3 4\n", ["1 2", "3 4"], None),
        ("x\n", ["x"], None),
        ("a,b\n1,2\n", ["1,2"], ","),
        ("1,5;2\n3;4\n", ["1.5;2", "3;4"], ";"),
        ("# 3, 4\n1 2\n", ["# 3, 4", "1 2"], None),
        ("# by x\na;b\n1,5;2\n", ["# by x", "1.5;2"], ";"),
        ("#\n", ["#"], None),
        ("nan\n1\n", ["nan", "1"], None),
    ],
)
def test_lines_of_numbers_are_read_as_spreadsheets_write_them(text, lines, between):
    assert number_lines(text) == (lines, between)
