import os
from pathlib import Path

import pytest

from esd.mesh.mesh import Mesh
from esd.mesh.shapes import icosphere, torus


@pytest.fixture(autouse=True)
def _own_cache(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ESD_CACHE", str(tmp_path_factory.getbasetemp() / "cache"))


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
def real_data() -> Path:
    folder = Path(os.environ.get("ESD_DATA", Path(__file__).parents[2] / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip(f"no real shapes at '{folder}'; name their folder in ESD_DATA")
    return folder
