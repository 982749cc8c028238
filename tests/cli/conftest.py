from pathlib import Path

import numpy as np
import pytest

from esd.matching.correspondence import Correspondence, save_map
from esd.mesh.io.meshes import write_mesh
from esd.mesh.mesh import Mesh
from esd.mesh.shapes import subdivide, torus


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
