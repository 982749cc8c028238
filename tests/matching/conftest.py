import numpy as np
import pytest

from esd.learning.model import load_model
from esd.matching.features import shape_features
from esd.mesh.mesh import Mesh
from esd.mesh.repair.repair import repair


@pytest.fixture
def pair(blob):
    """Two shapes of one pose, vertex i of one being vertex i of the other."""
    model = load_model("default")
    bend = 0.05 * np.sin(blob.vertices[:, [1, 2, 0]] * 2 + np.arange(3))
    other = Mesh((blob.vertices + bend) @ [[0, 1, 0], [0, 0, 1], [1, 0, 0]], blob.faces)
    return tuple(shape_features(repair(mesh), model=model) for mesh in (blob, other))
