import numpy as np

from esd.mesh.mesh import Mesh
from esd.mesh.shapes import icosphere
from esd.viewing.colours import UNMATCHED, carried_colours, oklab_to_rgb, position_colours


def test_oklab_of_the_primaries():
    lightness, a, b = np.array(  # Ottosson's own values, rounded to three digits
        [(1.0, 0.0, 0.0), (0.628, 0.225, 0.126), (0.866, -0.234, 0.179), (0.452, -0.032, -0.312)]
    ).T
    expected = [(1, 1, 1), (1, 0, 0), (0, 1, 0), (0, 0, 1)]
    np.testing.assert_allclose(oklab_to_rgb(lightness, a, b), expected, atol=0.03)


def test_ends_of_a_shape_differ_for_people_who_do_not_see_red_or_green():
    """By Machado et al. 2009, severity 1: the ends of the two longest sides stay far apart."""
    protan = [
        [0.152286, 1.052583, -0.204868],
        [0.114503, 0.786281, 0.099216],
        [-0.003882, -0.048116, 1.051998],
    ]
    deutan = [
        [0.367322, 0.860646, -0.227968],
        [0.280085, 0.672501, 0.047413],
        [-0.011820, 0.042940, 0.968881],
    ]
    sphere = icosphere(3)
    mesh = Mesh(sphere.vertices * [2, 1, 3], sphere.faces)
    colours = position_colours(mesh)
    assert 0 <= colours.min() <= colours.max() <= 1
    for matrix in (np.eye(3), np.array(protan), np.array(deutan)):
        linear = np.where(colours <= 0.04045, colours / 12.92, ((colours + 0.055) / 1.055) ** 2.4)
        seen = np.clip(linear @ matrix.T, 0, 1) ** (1 / 2.4)
        for axis in (0, 2):
            ends = seen[[mesh.vertices[:, axis].argmin(), mesh.vertices[:, axis].argmax()]]
            assert np.linalg.norm(ends[0] - ends[1]) > 0.25


def test_vertices_without_a_match_are_grey():
    carried = carried_colours(np.eye(3), np.array([2, -1]))
    np.testing.assert_array_equal(carried, [[0, 0, 1], UNMATCHED])
