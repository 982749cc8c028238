import re
from pathlib import Path

import pytest

from esd.common import install_hint

ROOT = Path(__file__).parents[1]


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
