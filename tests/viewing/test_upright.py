from pathlib import Path

import numpy as np
import pytest

from esd.mesh.mesh import Mesh
from esd.mesh.shapes import grid, icosphere, torus
from esd.viewing.upright import default_up, usual_up
from standing import animal

UPRIGHT = {"y": (0, 1, 2), "z": (0, 2, 1)}
"""Orders of the coordinates of a shape that stands on y, by the axis that is then up."""


@pytest.mark.parametrize("axis", UPRIGHT)
@pytest.mark.parametrize("sign", [1, -1])
def test_what_stands_on_legs_is_upright(axis, sign):
    mesh = animal()
    turned = Mesh(sign * mesh.vertices[:, UPRIGHT[axis]] * 7 + 3, mesh.faces)
    assert default_up(turned) == ("" if sign == 1 else "-") + axis


def test_what_shows_no_feet_has_the_usual_axis_up():
    assert default_up(icosphere(3)) == "y"
    assert default_up(torus(24, 16)) == "y"
    flat = grid(5, 4)
    for order, up in (((0, 1, 2), "y"), ((2, 1, 0), "z")):
        assert default_up(Mesh(flat.vertices[:, order] * (1 + np.arange(3)), flat.faces)) == up
    assert default_up(Mesh(0 * flat.vertices, flat.faces)) == "y"  # a single point


def test_what_a_format_says_is_usual():
    assert usual_up(Path("a.GLB")) == "y"
    assert usual_up(Path("a.obj")) is None
    tall = Mesh(icosphere(3).vertices * [1, 1, 2], icosphere(3).faces)
    assert default_up(tall) == "z"
    flat = Mesh(icosphere(3).vertices * [1, 1, 0.9], icosphere(3).faces)
    assert default_up(flat, usual="z") == "z"


def test_people_and_animals_are_upright(real_data):
    from esd.mesh.io.meshes import read_mesh

    for name, up in (
        *(("faust_r/shapes/tr_reg_000.off", "y"), ("faust_r/shapes/tr_reg_079.off", "y")),
        *(("heads/h00.ply", "y"), ("tosca_r/shapes/cat0.off", "z")),
        *(("smal_r/shapes/wolf_alph2.off", "-y"), ("artists/human_man.obj", "y")),
    ):
        assert default_up(read_mesh(real_data / name)) == up, name
