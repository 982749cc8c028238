import logging
import os
import shutil
import sys
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from esd.cli import main
from esd.datasets.collection import Collection, Shape
from esd.mesh.io.meshes import write_mesh
from esd.mesh.mesh import Mesh
from esd.mesh.shapes import icosphere, torus


@pytest.fixture(autouse=True)
def _own_cache(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    base = tmp_path_factory.getbasetemp()
    # processes that share the tests share their spectra
    shared = base.parent if "PYTEST_XDIST_WORKER" in os.environ else base
    monkeypatch.setenv("ESD_CACHE", str(shared / "cache"))


@pytest.fixture
def sphere() -> Mesh:
    return icosphere(3)


@pytest.fixture
def blob() -> Mesh:
    """A closed surface without symmetry: a torus whose tube swells and bends."""
    mesh = torus(32, 16)
    x, y, z = mesh.vertices.T.copy()
    swell = 1 + 0.3 * x + 0.2 * y * z
    return Mesh(
        (mesh.vertices * swell[:, None]) + 0.1 * mesh.vertices[:, [1, 2, 0]] ** 2, mesh.faces
    )


@pytest.fixture
def capped(blob: Mesh) -> Mesh:
    """The blob with a vertex more on a side of every tenth face, which makes a line of a face."""
    split = np.arange(0, len(blob.faces), 10)
    a, b, c = blob.faces[split].T
    new = len(blob.vertices) + np.arange(len(split))
    middle = (blob.vertices[a] + blob.vertices[b]) / 2
    pieces = [np.stack(corners, axis=1) for corners in ((a, b, new), (b, c, new), (c, a, new))]
    faces = np.concatenate([np.delete(blob.faces, split, axis=0), *pieces])
    return Mesh(np.concatenate([blob.vertices, middle]), faces)


@pytest.fixture
def collection(blob: Mesh) -> Collection:
    """Four bent copies of one shape; point p of the template is vertex p, but for one missing."""

    def copy(i: int) -> Mesh:
        bend = np.sin(np.arange(3) + blob.vertices[:, [1, 2, 0]] * (1 + 0.3 * i))
        return Mesh(blob.vertices + 0.1 * i * bend, blob.faces)

    index = np.arange(len(blob.vertices))
    index[7] = -1
    shapes = [Shape(f"c{i}", f"s{i}", "t", lambda i=i: copy(i), lambda: index) for i in range(4)]
    return Collection("copies", tuple(shapes))


@pytest.fixture
def shapes(tmp_path: Path) -> Path:
    """Folder of meshes of one connectivity, of four subjects, each bent a little more."""
    folder = tmp_path / "set"
    folder.mkdir()
    mesh = torus(24, 16)
    for i in range(4):
        bend = np.sin(mesh.vertices[:, [1, 2, 0]] * (1 + 0.2 * i) + np.arange(3))
        write_mesh(Mesh(mesh.vertices + 0.2 * bend, mesh.faces), folder / f"tr_reg_0{i}0.off")
    return folder


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


@pytest.fixture(scope="session", autouse=True)
def _as_they_are():
    """Small meshes are not subdivided before they are matched, which takes most of the time."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("esd.matching.features._FEWEST", 300)
        yield


@pytest.fixture
def subdivided(monkeypatch) -> None:
    """Small meshes are subdivided before they are matched, as they are for users."""
    monkeypatch.setattr("esd.matching.features._FEWEST", 2000)


@pytest.fixture
def real_data() -> Path:
    folder = Path(os.environ.get("ESD_DATA", Path(__file__).parents[2] / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip(f"no real shapes at '{folder}'; name their folder in ESD_DATA")
    return folder


@pytest.fixture(scope="session")
def browser():
    """A headless Chromium, which draws without a graphics card."""
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    path = os.environ.get("CHROMIUM") or shutil.which("chromium") or shutil.which("google-chrome")
    if path is None:
        pytest.skip("no Chromium on this machine; name one in CHROMIUM")
    software = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
    with playwright.sync_playwright() as run:
        started = run.chromium.launch(executable_path=path, args=software)
        yield started
        started.close()
