"""The examples of the documentation run: each fenced block of a page, in order."""

import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

import esd
from esd.cli import main

DOCS = Path(__file__).parents[1] / "docs"
README = DOCS.parent / "README.md"
PAGES = [page for page in (README, *sorted(DOCS.rglob("*.md"))) if "```" in page.read_text()]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_examples_of_a_page(page, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    blocks = re.findall(r"^```(\w+)\n(.*?)^```", page.read_text(), flags=re.DOTALL | re.MULTILINE)
    assert {language for language, _ in blocks} <= {"sh", "python"}
    for language, block in blocks:
        if language == "python":
            pytest.importorskip("sklearn", reason="scikit-learn is not installed")
            exec(compile(block, str(page), "exec"), {"__name__": "example"})
            continue
        for line in block.splitlines():
            if line.startswith("esd "):  # in this process, which saves the time of a start
                monkeypatch.setattr(sys, "argv", shlex.split(line))
                with pytest.raises(SystemExit) as ended:
                    main()
                assert ended.value.code == 0, (line, capsys.readouterr().err)
            else:
                subprocess.run(["bash", "-ec", line], check=True)


def test_tests_that_a_page_names_exist():
    written = "\n".join(file.read_text() for file in Path(__file__).parent.rglob("test_*.py"))
    named = set(re.findall(r"`(test_\w+)`", (DOCS / "robustness.md").read_text()))
    assert len(named) > 15
    assert {name for name in named if f"def {name}(" not in written} == set()


def test_the_reference_lists_every_public_name():
    listed = set(re.findall(r"^::: ([\w.]+)$", (DOCS / "reference.md").read_text(), re.MULTILINE))
    assert {
        home.replace(":", ".") if ":" in home else f"{home}.{name}"
        for name, home in esd._HOMES.items()
    } - listed == set()
