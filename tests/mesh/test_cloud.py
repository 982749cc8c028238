import numpy as np
import pytest

from esd.common import InputError
from esd.mesh.cloud import surface_between
from esd.mesh.geometry import surface_area
from esd.mesh.mesh import PointCloud
from esd.mesh.shapes import grid, icosphere


def test_points_of_a_sphere_give_nearly_its_surface():
    sphere = icosphere(3)
    found = surface_between(PointCloud(sphere.vertices))
    np.testing.assert_array_equal(found.vertices, sphere.vertices)
    # its faces, but for those where points choose differently
    assert surface_area(found) == pytest.approx(surface_area(sphere), rel=0.05)
    corners = found.vertices[found.faces]
    outward = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (np.einsum("ij,ij->i", outward, corners[:, 0]) > 0).mean() > 0.9
    assert set(np.unique(found.faces)) == set(range(len(sphere.vertices)))


def test_a_grid_has_no_gaps():
    flat = grid(10, 10)
    found = surface_between(PointCloud(flat.vertices))
    assert surface_area(found) == pytest.approx(surface_area(flat), rel=0.1)  # some at the rim


def test_no_triangle_spans_a_gap_or_lies_on_a_line():
    sphere = icosphere(3)
    two = PointCloud(np.concatenate([sphere.vertices, sphere.vertices * [1, 1, -1] + 5.0]))
    faces = surface_between(two).faces
    assert (np.ptp(faces // len(sphere.vertices), axis=1) == 0).all()
    with pytest.raises(InputError, match="Expected more than 12 points; got 4"):
        surface_between(PointCloud(sphere.vertices[:4]))
    line = PointCloud(np.arange(30)[:, None] * np.ones(3))
    with pytest.raises(InputError, match="No surface can be seen between the points"):
        surface_between(line)
