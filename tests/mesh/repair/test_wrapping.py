import numpy as np
import pytest

from damaged import joined
from esd.mesh.geometry import edges, surface_area
from esd.mesh.mesh import Mesh
from esd.mesh.repair.wrapping import _samples, pieces_within, surface_around
from esd.mesh.shapes import icosphere
from esd.mesh.topology import boundary_edges
from measures import signed_volume

SPHERE = icosphere(4)


def halves(gap: float) -> Mesh:
    """The unit sphere as two open halves, moved apart by a gap."""
    upper = SPHERE.vertices[SPHERE.faces, 2].mean(axis=1) > 0
    shift = [0, 0, gap / 2]
    parts = [
        Mesh(SPHERE.vertices + shift, SPHERE.faces[upper]),
        Mesh(SPHERE.vertices - shift, SPHERE.faces[~upper]),
    ]
    return Mesh(*joined(*parts))


@pytest.mark.parametrize("gap", [0.0, 0.05, 0.15])
def test_two_halves_become_one_closed_surface_of_their_area_and_volume(gap):
    around = surface_around(halves(gap), 3000)
    assert len(boundary_edges(around)) == 0
    assert len(around.vertices) - len(edges(around)) + len(around.faces) == 2  # a sphere
    whole = 4 * np.pi + 2 * np.pi * gap, 4 / 3 * np.pi + np.pi * gap  # with a cylinder between
    # its cells have sides of 0.065, and the surface moves back by nine tenths of twice that
    assert surface_area(around) == pytest.approx(whole[0], rel=0.06)
    assert signed_volume(around) == pytest.approx(whole[1], rel=0.06)


def test_what_is_inside_belongs_to_it_and_what_is_far_away_does_not():
    inner = Mesh(SPHERE.vertices * 0.97, SPHERE.faces)
    far = Mesh(SPHERE.vertices / 2 + 5, SPHERE.faces)
    mesh = Mesh(*joined(SPHERE, inner, far))
    around = surface_around(mesh, 3000)
    assert np.linalg.norm(around.vertices, axis=1).max() < 1.1
    count = len(SPHERE.faces)
    within = pieces_within(mesh, around)
    np.testing.assert_array_equal(within, np.arange(3 * count) < 2 * count)


def test_a_sheet_encloses_nothing():
    bowl = Mesh(SPHERE.vertices, SPHERE.faces[SPHERE.vertices[SPHERE.faces, 2].mean(axis=1) < 0])
    assert surface_around(bowl, 2000) is None


def test_samples_are_dense_on_large_faces_and_few_on_slivers():
    triangle = Mesh(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), np.array([[0, 1, 2]]))
    points = _samples(triangle, 0.1)
    grid = np.random.default_rng(0).dirichlet(np.ones(3), 200) @ triangle.vertices
    gap = np.linalg.norm(grid[:, None] - points, axis=2).min(axis=1)
    assert gap.max() <= 0.1
    sliver = Mesh(triangle.vertices * [1, 1e-6, 1], triangle.faces)
    assert len(_samples(sliver, 0.01)) <= 2 * 102  # ends of the steps, on both sides
