"""Write what esd answers to every kind of bad input that the tests have to docs/robustness.md.

    python tools/list_bad_input.py

runs each command of `tests/test_bad_input.py`, and reads each file of `tests/hostile_files.py`.
"""

from __future__ import annotations

import contextlib
import io
import logging
import os
import sys
import tempfile
from pathlib import Path

from esd.cli import main as esd
from esd.common import InputError
from esd.mesh.io.meshes import read_mesh

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "robustness.md"
BEGIN, END = "<!-- written by tools/list_bad_input.py -->", "<!-- end of what it writes -->"


def answer(arguments: tuple[str, ...]) -> tuple[int, str]:
    """Exit code of a command, and the last line of what it said on standard error."""
    sys.argv = ["esd", *arguments]
    said, code = io.StringIO(), 0
    handler = logging.StreamHandler(io.StringIO())
    logging.getLogger().handlers = [handler]
    with contextlib.redirect_stderr(said), contextlib.redirect_stdout(io.StringIO()):
        try:
            esd()
        except SystemExit as ended:
            code = int(ended.code or 0)
    box = "\u2502\u2500\u256d\u256e\u2570\u256f "  # in which wrong usage is shown
    lines = [line.strip(box) for line in said.getvalue().splitlines()]
    lines = [line for line in lines if line and not line.startswith(("Usage", "Try", "Error"))]
    return code, " ".join(lines[-1:]).removeprefix("esd: ")


def refusal(path: Path) -> str:
    """Why a file is not read."""
    try:
        read_mesh(path)
    except InputError as error:
        return " ".join(str(error).split())
    raise AssertionError(f"'{path}' was read")


def cell(text: str) -> str:
    """Text in a cell of a table, on one line and not as long as a page."""
    text = text.replace("|", "").replace("<", "&lt;").replace("*", "\\*")
    return text if len(text) <= 200 else text[:199] + "\u2026"


def tables() -> list[str]:
    """Lines of the two tables."""
    sys.path.insert(0, str(ROOT / "tests"))
    from hostile_files import HOSTILE
    from test_bad_input import CASES, make_inputs

    here = Path.cwd()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        make_inputs(folder)
        os.chdir(folder)
        lines = ["| command | exit code | answer |", "|---|--:|---|"]
        for arguments, *_ in CASES:
            code, said = answer(arguments)
            command = " ".join(["esd", *arguments])
            said = said.replace(f"{folder}/", "")
            lines.append(f"| `{command.replace('|', '')}` | {code} | {cell(said)} |")
        lines += ["", "| file | answer |", "|---|---|"]
        for file, content in sorted(HOSTILE.items()):
            Path(file).write_bytes(content)
            lines.append(f"| `{file}` | {cell(refusal(Path(file)))} |")
        os.chdir(here)
    return lines


def main() -> None:
    """Replace the part of the page between the two comments."""
    os.environ |= {"COLUMNS": "400", "ESD_CACHE": "off"}
    before, _, rest = PAGE.read_text(encoding="utf-8").partition(BEGIN)
    _, _, after = rest.partition(END)
    PAGE.write_text("\n".join([before + BEGIN, "", *tables(), "", END + after]), encoding="utf-8")


if __name__ == "__main__":
    main()
