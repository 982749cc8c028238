import pytest

from esd.mesh.mesh import Mesh
from esd.mesh.shapes import icosphere
from esd.population.atlas import Atlas, atlas


@pytest.fixture
def ellipsoids() -> Atlas:
    """Of ellipsoids of one connectivity, longer and longer along x."""
    sphere = icosphere(2)
    meshes = [Mesh(sphere.vertices * [1 + 0.1 * i, 1, 1], sphere.faces) for i in range(6)]
    return atlas(meshes, registered=True)
