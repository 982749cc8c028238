import numpy as np
import pytest

from esd.mesh.geometry import edge_lengths, face_areas, is_consistently_oriented, surface_area
from esd.mesh.mesh import Mesh
from esd.mesh.remesh.refinement import refined
from esd.mesh.shapes import grid, torus
from esd.mesh.topology import boundary_edges, edge_table


@pytest.mark.parametrize("mesh", [torus(9, 5), grid(4, 6)], ids=["closed", "open"])
def test_a_refinement_is_the_same_surface_with_short_edges(mesh):
    fine = refined(mesh, 0.13)
    assert edge_lengths(fine.mesh).max() <= 0.13
    assert surface_area(fine.mesh) == pytest.approx(surface_area(mesh))
    np.testing.assert_array_equal(fine.mesh.vertices[: len(mesh.vertices)], mesh.vertices)
    # the parts of each old face have its area
    parts = np.bincount(fine.parent, weights=face_areas(fine.mesh), minlength=len(mesh.faces))
    np.testing.assert_allclose(parts, face_areas(mesh))
    assert is_consistently_oriented(fine.mesh)
    table = edge_table(fine.mesh.faces, len(fine.mesh.vertices))
    assert table.count.max() == 2
    assert len(fine.rim) == len(boundary_edges(fine.mesh))


def test_short_edges_are_not_cut():
    mesh = Mesh([[0, 0, 0], [1, 0, 0], [0, 0.1, 0]], [[0, 1, 2]])
    fine = refined(mesh, 0.6)
    assert len(fine.mesh.vertices) == 5  # the two long sides are halved
    assert len(fine.mesh.faces) == 3
    assert len(refined(mesh, 2).mesh.faces) == 1
