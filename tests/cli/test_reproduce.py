import os
from pathlib import Path


def files(folder: Path) -> set[str]:
    return {name for _, _, names in os.walk(folder) for name in names}


def test_experiments_write_reports_and_go_on(run, shapes, tmp_path):
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
