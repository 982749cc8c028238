import pickle
from functools import partial

import numpy as np
import pytest

from esd.common import InputError
from esd.datasets.collection import Shape
from esd.datasets.parts import (
    PARTS,
    Perturbed,
    beyond_plane,
    in_view,
    outside_balls,
    part_of,
    part_of_shape,
    part_with,
    random_eye,
)
from esd.mesh.geometry import is_referenced, surface_area
from esd.mesh.mesh import Mesh
from esd.mesh.repair.diagnose import diagnose
from esd.mesh.shapes import icosphere

SPHERE = icosphere(4)


def _same(value):  # lambdas go to no other process
    return value


@pytest.mark.parametrize("kind", PARTS)
def test_parts_are_repeatable_and_have_exact_maps_both_ways(blob, kind):
    first, again, other = (part_of(blob, kind, seed=seed) for seed in (3, 3, 4))
    np.testing.assert_array_equal(first.vertex_index, again.vertex_index)
    assert not np.array_equal(first.vertex_index, other.vertex_index)
    assert is_referenced(first.mesh).all()
    back = first.original_index()
    np.testing.assert_array_equal(first.vertex_index[back], np.arange(len(back)))
    np.testing.assert_array_equal(first.mesh.vertices, blob.vertices[back])
    assert 0.05 < surface_area(first.mesh) / surface_area(blob) < 0.98
    assert len(diagnose(first.mesh, thorough=False).findings) >= 1  # it is open


def test_balls_are_geodesic_and_have_the_radius_asked_for():
    # a cap of the unit sphere with geodesic radius a has the area 2π(1 − cos a)
    radius = 0.16 * np.sqrt(4 * np.pi)
    keep = outside_balls(SPHERE, 1, 0.16)
    removed = surface_area(SPHERE) - surface_area(part_with(SPHERE, keep).mesh)
    # up to a row of faces, of width 0.07, around the cap
    assert removed == pytest.approx(2 * np.pi * (1 - np.cos(radius)), rel=0.25)
    more = outside_balls(SPHERE, 13, 0.10)
    assert more.sum() < keep.sum()


def test_a_camera_sees_the_cap_of_a_sphere_that_faces_it():
    eye = np.array([0.0, 0.0, 5.0])
    centre = SPHERE.vertices[SPHERE.faces].mean(axis=1)
    seen = in_view(SPHERE, eye)
    cosine = np.einsum("ij,ij->i", centre, eye - centre) / np.linalg.norm(eye - centre, axis=1)
    assert seen[cosine > 0.3].all()  # edge-on faces, with a cosine below 0.2, are not measured
    assert not seen[cosine < 0.1].any()


def test_what_is_behind_is_not_seen():
    behind = Mesh(
        np.concatenate([SPHERE.vertices, 2 * SPHERE.vertices + [0, 0, -6]]),
        np.concatenate([SPHERE.faces, SPHERE.faces + len(SPHERE.vertices)]),
    )
    seen = in_view(behind, np.array([0.0, 0.0, 20.0]))[len(SPHERE.faces) :]
    centre = behind.vertices[behind.faces[len(SPHERE.faces) :]].mean(axis=1)
    across = np.hypot(*centre[:, :2].T)
    # seen from 20, the ball of radius 1 hides about 1.25 of what is 5 behind it
    assert not seen[across < 1.0].any()
    assert seen[(across > 1.5) & (across < 1.8) & (centre[:, 2] > -6)].all()


def test_cuts_have_the_share_asked_for():
    keep = beyond_plane(SPHERE, 0.35, seed=2)
    left = surface_area(Mesh(SPHERE.vertices, SPHERE.faces[keep])) / surface_area(SPHERE)
    assert left == pytest.approx(0.65, abs=0.001)


def test_parts_of_shapes_lack_points_and_go_to_other_processes(blob):
    index = np.arange(len(blob.vertices))
    index[5] = -1
    points = partial(_same, index)
    shape = Shape("a", "s", "t", partial(_same, blob), points, symmetric=points)
    part = pickle.loads(pickle.dumps(part_of_shape(shape, "cut of 35 %", seed=1)))
    assert part.name == "a, cut of 35 %, 1"
    assert part.subject == "s"
    here, mesh = part.correspondence(), part.mesh()
    known = here >= 0
    assert not known[5]
    assert 0.3 < known.mean() < 0.9
    np.testing.assert_array_equal(mesh.vertices[here[known]], blob.vertices[index[known]])
    np.testing.assert_array_equal(part.symmetric(), here)


def test_the_first_of_welded_vertices_is_the_original():
    welded = Perturbed(icosphere(0), np.array([0, 1, 1, *range(2, 12), -1]))
    np.testing.assert_array_equal(welded.original_index(), [0, 1, *range(3, 13)])


def test_impossible_parts_are_refused(blob):
    for count, radius in ((0, 0.1), (1, 0.0)):
        with pytest.raises(InputError, match="`count` must be at least 1 and `radius` positive"):
            outside_balls(blob, count, radius)
    with pytest.raises(InputError, match="`level` must be from 0 to below 1"):
        beyond_plane(blob, 1.0)
    with pytest.raises(InputError, match="outside the ball around the shape"):
        in_view(blob, blob.vertices[0])
    assert np.linalg.norm(random_eye(blob)) > np.abs(blob.vertices).max()
    with pytest.raises(InputError, match="Nothing is left of the mesh"):
        part_with(blob, np.zeros(len(blob.faces), dtype=bool))
    shape = Shape("a", "s", "t", lambda: blob, lambda: np.arange(3))
    for call in (lambda: part_of(blob, "half"), lambda: part_of_shape(shape, "half")):
        with pytest.raises(InputError, match="no parts of kind 'half'; there are balls, medium"):
            call()
