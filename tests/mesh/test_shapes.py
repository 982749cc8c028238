import numpy as np
import pytest

from esd.mesh import geometry as m
from esd.mesh.shapes import subdivide, torus
from measures import signed_volume


def test_subdivision_keeps_the_first_vertices():
    mesh = torus(6, 5)
    fine = subdivide(mesh)
    np.testing.assert_array_equal(fine.vertices[: len(mesh.vertices)], mesh.vertices)
    assert m.surface_area(fine) == pytest.approx(m.surface_area(mesh))
    assert signed_volume(fine) == pytest.approx(signed_volume(mesh))
