import numpy as np
import pytest

from esd.learning.model import load_model, raw_model
from esd.matching.candidates import Sampled, sampled
from esd.matching.features import shape_features
from esd.mesh.mesh import Mesh
from esd.mesh.repair.repair import repair
from esd.mesh.shapes import torus


@pytest.fixture
def pair(blob):
    """Two shapes of one pose, vertex i of one being vertex i of the other."""
    model = load_model("default")
    bend = 0.05 * np.sin(blob.vertices[:, [1, 2, 0]] * 2 + np.arange(3))
    other = Mesh((blob.vertices + bend) @ [[0, 1, 0], [0, 0, 1], [1, 0, 0]], blob.faces)
    return tuple(shape_features(repair(mesh), model=model) for mesh in (blob, other))


@pytest.fixture(scope="module")
def bodies() -> tuple[Sampled, Sampled]:
    """Two shapes of one pose, vertex i of one being vertex i of the other."""
    mesh = torus(32, 16)
    x, y, z = mesh.vertices.T
    swell = mesh.vertices * (1 + 0.3 * x + 0.2 * y * z)[:, None]
    bend = 0.05 * np.sin(swell[:, [1, 2, 0]] * 2 + np.arange(3))
    return tuple(
        sampled(shape_features(repair(Mesh(vertices, mesh.faces)), model=raw_model("hks")))
        for vertices in (swell, swell + bend)
    )
