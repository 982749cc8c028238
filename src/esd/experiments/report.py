"""What an experiment found, as files."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from esd.common import whole_file


@dataclass(frozen=True, slots=True)
class Table:
    """A table of an experiment.

    Parameters
    ----------
    name
        Of its CSV file.
    caption
        What its numbers are.
    header, rows
        Texts and numbers; None where there is nothing to tell.
    shown
        Whether the report shows it too, which is for tables of few rows.
    """

    name: str
    caption: str
    header: tuple[str, ...]
    rows: tuple[tuple[object, ...], ...]
    shown: bool = True


@dataclass(frozen=True, slots=True)
class Report:
    """What an experiment found.

    Parameters
    ----------
    title
        Of the report.
    findings
        Sentences, in markdown.
    tables
        In order.
    """

    title: str
    findings: tuple[str, ...]
    tables: tuple[Table, ...]


def write_report(
    report: Report, folder: Path, *, facts: Mapping[str, object], figures: Sequence[str]
) -> None:
    """Write `report.md` and a CSV file for each table.

    Parameters
    ----------
    facts
        How it came about: command, data, seed, versions, time.
    figures
        Names of the figures in the folder, without suffix.
    """
    parts = [f"# {report.title}", *report.findings]
    for table in report.tables:
        _write_csv(table, folder / f"{table.name}.csv")
        if table.shown:
            parts += [f"{table.caption} ([{table.name}.csv]({table.name}.csv))", markdown(table)]
        else:
            parts.append(f"{table.caption}: [{table.name}.csv]({table.name}.csv)")
    parts += [f"![{name}]({name}.png)" for name in figures]
    parts += ["## How it was made", "\n".join(f"- {key}: {value}" for key, value in facts.items())]
    with whole_file(folder / "report.md") as temporary:
        temporary.write_text("\n\n".join(parts) + "\n", encoding="utf-8")


def markdown(table: Table) -> str:
    """A table in markdown, numbers to four digits."""
    lines = [table.header, ["--"] * len(table.header), *table.rows]
    return "\n".join(f"| {' | '.join(_text(cell) for cell in line)} |" for line in lines)


def _text(cell: object) -> str:
    if cell is None:
        return ""
    return f"{cell:.4g}" if isinstance(cell, float) else str(cell)


def _write_csv(table: Table, path: Path) -> None:
    with whole_file(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(table.header)
        writer.writerows(table.rows)
