import csv
import json

from esd.experiments.report import Report, Table, write_report
from esd.experiments.setting import provenance


def test_reports_hold_tables_figures_and_how_they_were_made(made, tmp_path):
    table = Table("numbers", "Some numbers", ("a", "b"), ((1, 0.123456), ("x", None)))
    hidden = Table("more", "More", ("c",), ((2,),), shown=False)
    report = Report("Title", ("A finding.",), (table, hidden))
    facts = {"Command": "`esd`", **provenance([made])}
    write_report(report, tmp_path, facts=facts, figures=["picture"])
    text = (tmp_path / "report.md").read_text()
    for part in ("# Title", "A finding.", "| 1 | 0.1235 |", "| x |  |", "![picture](picture.png)"):
        assert part in text
    assert "4 shapes of s2, s3" in text
    assert "esd 0." in text
    assert "| c |" not in text
    with (tmp_path / "numbers.csv").open(newline="") as file:
        assert list(csv.reader(file)) == [["a", "b"], ["1", "0.123456"], ["x", ""]]
    assert json.dumps(provenance([made]))
