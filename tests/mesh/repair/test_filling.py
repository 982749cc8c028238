import numpy as np

from esd.mesh.geometry import is_consistently_oriented
from esd.mesh.mesh import Mesh
from esd.mesh.repair.filling import holes_filled
from esd.mesh.shapes import grid, icosphere
from esd.mesh.topology import boundary_edges
from measures import signed_volume

SPHERE = icosphere(4)


def without(mesh: Mesh, gone) -> Mesh:
    """The mesh without faces of which a vertex is so."""
    return Mesh(mesh.vertices, mesh.faces[~gone[mesh.faces].any(axis=1)])


def test_a_patch_continues_a_sphere():
    x, _, z = SPHERE.vertices.T
    pierced = without(SPHERE, (z > 0.93) | (x < -0.97))
    filled, rim = holes_filled(pierced, shorter_than=1.0)
    assert len(boundary_edges(filled)) == 0
    assert is_consistently_oriented(filled)
    new = filled.vertices[len(SPHERE.vertices) :]
    assert len(new) == len(rim) > 40
    np.testing.assert_array_equal(filled.vertices[: len(SPHERE.vertices)], SPHERE.vertices)
    np.testing.assert_allclose(np.linalg.norm(new, axis=1), 1, atol=0.03)
    assert abs(signed_volume(filled) / signed_volume(SPHERE) - 1) < 0.005
    assert np.isin(rim, boundary_edges(pierced)).all()
    assert np.linalg.norm(new - SPHERE.vertices[rim], axis=1).max() < 0.45  # the larger's radius


def test_a_patch_of_a_plane_is_plane_and_the_outer_rim_stays():
    mesh = grid(30, 30)
    middle = np.linalg.norm(mesh.vertices - mesh.vertices.mean(axis=0), axis=1)
    filled, _ = holes_filled(without(mesh, middle < 0.12), shorter_than=1.5)
    np.testing.assert_allclose(filled.vertices[:, 2], 0, atol=1e-12)
    assert len(boundary_edges(filled)) == len(boundary_edges(mesh))


def test_a_missing_face_is_put_back():
    filled, rim = holes_filled(Mesh(SPHERE.vertices, SPHERE.faces[1:]), shorter_than=0.5)
    assert len(rim) == 0
    assert set(filled.faces[-1]) == set(SPHERE.faces[0])
    assert is_consistently_oriented(filled)


def test_rims_that_are_no_simple_loop_and_long_ones_stay():
    around = SPHERE.faces[(SPHERE.faces == SPHERE.faces[0, 0]).any(axis=1)]
    opposite = around[[not set(face) & (set(around[0]) - {SPHERE.faces[0, 0]}) for face in around]]
    gone = {tuple(around[0]), tuple(opposite[0])}  # two holes that touch at a vertex
    eight = Mesh(SPHERE.vertices, np.array([f for f in SPHERE.faces if tuple(f) not in gone]))
    assert holes_filled(eight, shorter_than=9.0)[0] is eight
    bowl = without(SPHERE, SPHERE.vertices[:, 2] > 0.2)
    assert holes_filled(bowl, shorter_than=1.0)[0] is bowl


def test_a_rim_in_one_place_is_filled():
    pierced = without(SPHERE, SPHERE.vertices[:, 2] > 0.95)
    rim = np.unique(boundary_edges(pierced))
    vertices = SPHERE.vertices.copy()
    vertices[rim] = [0, 0, 1]
    filled, _ = holes_filled(Mesh(vertices, pierced.faces), shorter_than=0.5)
    assert len(boundary_edges(filled)) == 0
    np.testing.assert_allclose(filled.vertices[len(vertices) :], [[0, 0, 1]], atol=0.05)
