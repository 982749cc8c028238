"""What the benchmarks share: environments of other packages, and what a process costs.

python benchmarks/measure.py --peers FOLDER      # installs them all there, before measuring
"""

from __future__ import annotations

import argparse
import csv
import os
import re
import subprocess
import sys
import tempfile
import time
import venv
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
JOBS = Path(__file__).parent / "jobs"
PEERS = {
    "esd": [str(ROOT)],
    "pyfm": ["pyfmaps==1.3.1"],
    "geomfum": ["geomfum==1.0.0", "libigl"],  # brings torch
    "lapy": ["lapy==1.7.0", "cholespy", "threadpoolctl"],
}


@dataclass(frozen=True)
class Cost:
    """Of a process with all that it started: seconds, seconds of all cores, megabytes."""

    wall: float
    cpu: float
    memory: float
    output: str

    def cells(self) -> list[str]:
        return [f"{self.wall:.1f}", f"{self.cpu:.1f}", f"{self.memory:.0f}"]


def python_of(peer: str) -> Path:
    """The Python of a package's own environment, which is made where it is missing.

    It is kept, with what was installed, in the folder that ESD_PEERS or `--peers` names.
    """
    folder = Path(os.environ.get("ESD_PEERS") or ROOT / ".venv" / "peers") / peer
    python = folder / "bin" / "python"
    done = folder / "installed"
    wanted = "\n".join(PEERS[peer]) if peer != "esd" else _dependencies()
    if not done.exists() or done.read_text() != wanted:
        print(f"installing {' '.join(PEERS[peer])}", file=sys.stderr)
        venv.create(folder, with_pip=True)
        subprocess.run([python, "-m", "pip", "install", "--quiet", *PEERS[peer]], check=True)
        done.write_text(wanted)
    return python


def _dependencies() -> str:
    """What esd needs, as its project file lists it; its source is read from this folder."""
    text = (ROOT / "pyproject.toml").read_text()
    return re.search(r"^dependencies = \[.*?^\]", text, re.DOTALL | re.MULTILINE)[0]


def add_peers_option(parser: argparse.ArgumentParser) -> None:
    """Add `--peers FOLDER`, where environments of other packages are kept."""

    def keep(folder: str) -> str:
        os.environ["ESD_PEERS"] = str(Path(folder).resolve())
        return folder

    parser.add_argument("--peers", type=keep, help="folder of the other packages' environments")


def esd_command(*arguments: object) -> list[str]:
    """The command `esd`, with what it needs and no more installed."""
    return [str(python_of("esd")), "-m", "esd", *map(str, arguments)]


def job(peer: str, *arguments: object) -> list[str]:
    """A job of `benchmarks/jobs` in the environment of its package."""
    return [str(python_of(peer)), str(JOBS / f"{peer}.py"), *map(str, arguments)]


def cost(command: list[str], *, cache: Path | str = "off") -> Cost:
    """Run a command to its end.

    Raises
    ------
    RuntimeError
        With its last words, if it fails.
    """
    environment = os.environ | {"ESD_CACHE": str(cache), "PYTHONPATH": str(ROOT / "src")}
    with tempfile.TemporaryFile("w+") as output, tempfile.TemporaryFile("w+") as errors:
        start = time.perf_counter()
        process = subprocess.Popen(command, stdout=output, stderr=errors, env=environment)
        _, status, usage = os.wait4(process.pid, 0)
        wall = time.perf_counter() - start
        process.returncode = os.waitstatus_to_exitcode(status)
        output.seek(0)
        errors.seek(0)
        if process.returncode:
            raise RuntimeError(" ".join(errors.read().split())[-300:])
        cpu = usage.ru_utime + usage.ru_stime
        return Cost(wall, cpu, usage.ru_maxrss / 1024, output.read())


def rows_in(path: Path, columns: Sequence[str]) -> list[dict[str, str]]:
    """The rows that a CSV file has; one that is missing is made, with its header."""
    if not path.exists():
        path.write_text(",".join(columns) + "\n")
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def table(*columns: str) -> None:
    """Print the head of a table; columns after the first few hold numbers."""
    print("| " + " | ".join(columns) + " |")
    print("|:--" * 2 + "|--:" * (len(columns) - 2) + "|", flush=True)


def row(*cells: object) -> None:
    print("| " + " | ".join(map(str, cells)) + " |", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add_peers_option(parser)
    parser.parse_args()
    for peer in PEERS:
        print(f"{peer}: {python_of(peer)}")


if __name__ == "__main__":
    main()
