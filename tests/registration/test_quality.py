import numpy as np
import pytest

from esd.deformation.fit import Fit
from esd.mesh.mesh import Mesh, PointCloud
from esd.mesh.shapes import grid
from esd.registration.quality import distance_to, quality

PLANE = grid(9, 9)  # the unit square
UP = np.array([0.0, 0.0, 2.0])


def test_distances_are_to_the_surface_or_to_the_nearest_point():
    above = PLANE.vertices[PLANE.faces].mean(axis=1) + UP / 8
    np.testing.assert_allclose(distance_to(PLANE, above), 0.25, rtol=1e-12)
    points = PointCloud(PLANE.vertices)
    np.testing.assert_allclose(distance_to(points, PLANE.vertices + UP), 2, rtol=1e-12)


def test_vertices_without_a_face_are_no_surface():
    loose = Mesh(np.concatenate([PLANE.vertices, [[0.5, 0.5, 1.0]]]), PLANE.faces)
    np.testing.assert_allclose(distance_to(loose, np.array([[0.5, 0.5, 1.0]])), 1, rtol=1e-12)


def test_figures_are_those_of_the_supported_vertices_and_of_edges_beside_the_scale():
    supported = np.arange(81) >= 9
    vertices = 2 * PLANE.vertices + [0.0, 0.0, 0.1]
    vertices[:9] += [0.0, 0.0, 5.0]  # a row that the scan lacks
    scan = Mesh(2 * PLANE.vertices, PLANE.faces)
    found = quality(PLANE, scan, Fit(vertices, supported, 2.0))
    assert (found.distance, found.farthest) == (pytest.approx(0.1), pytest.approx(0.1))
    assert found.extent == 2
    assert found.relative_distance == pytest.approx(0.05)
    assert found.supported == pytest.approx(8 / 9)
    assert found.stretch[:2] == (pytest.approx(1), pytest.approx(1))
    assert found.stretch[2] > 10  # between the row and the rest
    nothing = quality(PLANE, scan, Fit(vertices, np.zeros(81, dtype=bool), 2.0))
    assert np.isnan(nothing.distance)
    assert np.isnan(nothing.farthest)
