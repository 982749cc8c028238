from types import SimpleNamespace

import numpy as np
import pytest

from esd.common import InputError
from esd.mesh.convert import as_mesh
from esd.mesh.shapes import torus

MESH = torus(7, 5)


def test_unstructured_grids_hold_triangles_and_quadrilaterals():
    cells = {5: np.array([[0, 1, 2]]), 9: np.array([[0, 1, 2, 3]])}
    grid = SimpleNamespace(points=MESH.vertices, cells_dict=cells)
    np.testing.assert_array_equal(as_mesh(grid).faces, [[0, 1, 2], [0, 1, 2], [0, 2, 3]])
    with pytest.raises(InputError, match="only cells of type 10"):
        as_mesh(SimpleNamespace(points=MESH.vertices, cells_dict={10: cells[9]}))
