import logging
import sys
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from esd.cli import main
from esd.matching.correspondence import Correspondence, save_map
from esd.mesh.io.meshes import write_mesh
from esd.mesh.mesh import Mesh
from esd.mesh.shapes import subdivide, torus


@pytest.fixture
def run_here(capsys, monkeypatch):
    """Run a command in this process, which saves the time of a start."""
    # no lines of progress, which a busy machine would have between what is tested
    monkeypatch.setattr("esd.cli.progress.SILENCE", 1e6)

    def run_command(*arguments: object, expect: int = 0, where: Path) -> SimpleNamespace:
        monkeypatch.chdir(where)
        monkeypatch.setattr(sys, "argv", ["esd", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            main()
            raise SystemExit(0)
        logging.getLogger().setLevel(logging.WARNING)
        stdout, stderr = capsys.readouterr()
        assert (ended.value.code or 0) == expect, stderr
        return SimpleNamespace(stdout=stdout, stderr=stderr)

    return run_command


@pytest.fixture
def run(run_here, tmp_path, monkeypatch):
    """The same in the folder of the test, with a wide terminal and no processes unless asked for."""
    monkeypatch.setenv("COLUMNS", "200")
    monkeypatch.setattr("esd.parallel.core_count", lambda: 1)
    return partial(run_here, where=tmp_path)


@pytest.fixture
def as_they_are(monkeypatch):
    """Small meshes are not subdivided before they are matched, which takes most of the time."""
    monkeypatch.setattr("esd.matching.features._FEWEST", 300)


@pytest.fixture
def pair(tmp_path) -> Path:
    """A torus, the same with four times the faces, and the map between them."""
    source = torus(12, 8)
    target = subdivide(source)
    write_mesh(source, tmp_path / "a.off")
    write_mesh(Mesh(target.vertices * [1, 1, 2], target.faces), tmp_path / "b.off")
    count = len(source.vertices)
    match = Correspondence(np.arange(count), np.zeros(count), np.ones(count))
    save_map(match, tmp_path / "map.csv")
    vertices = "\n".join(map(str, range(1, count + 1)))
    for name in "ab":
        (tmp_path / f"{name}.vts").write_text(vertices)
    return tmp_path
