import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from esd.deformation.elastic import Pull, elastic, nearest_rotations
from esd.mesh.mesh import Mesh
from esd.mesh.shapes import icosphere, subdivide, torus


def test_nearest_rotations_are_those_of_stretched_rotations():
    rotation = Rotation.random(5, random_state=0).as_matrix()
    # R S with S symmetric positive definite has the polar factor R
    found = nearest_rotations(rotation @ np.diag([3.0, 1.0, 0.5]))
    assert found == pytest.approx(rotation, abs=1e-12)
    assert np.linalg.det(nearest_rotations(-np.eye(3)[None])) == pytest.approx(1.0)


def test_three_places_of_a_moved_template_carry_all_of_it_along():
    rest = subdivide(torus(12, 8))
    rotation = Rotation.from_euler("xyz", [0.3, -0.2, 0.4]).as_matrix()
    moved = rest.vertices @ rotation.T + [1.0, 2.0, 3.0]
    weight = np.zeros(len(moved))
    weight[:: len(moved) // 60] = 1.0
    body = elastic(rest)
    image = np.where(weight[:, None] > 0, moved, 0.0)
    found = body.interpolated(image, weight)
    for _ in range(10):
        found = body.deformed(found, Pull(image, weight), 0.1)
    # the energy of a rigid motion is zero; the steps converge linearly
    assert np.abs(found - moved).max() < 0.02 * body.unit


def test_free_vertices_are_placed_as_at_rest():
    rest = subdivide(torus(12, 8))
    body = elastic(rest)
    free = np.zeros(len(rest.vertices), dtype=bool)
    free[rest.faces[0]] = True
    broken = rest.vertices + free[:, None] * [0.0, 0.0, -5.0]
    # the links to the displaced vertices held, of weight 1e-6, pull them by a millionth or so
    assert body.filled(broken, free) == pytest.approx(rest.vertices, abs=1e-4)


def test_free_vertices_are_flattened_to_the_mean_of_their_neighbours():
    rest = subdivide(torus(12, 8))
    free = np.zeros(len(rest.vertices), dtype=bool)
    free[rest.faces[(rest.faces == 5).any(axis=1)]] = True
    moved = rest.vertices + free[:, None] * [0.0, 0.0, -5.0]
    found = elastic(rest).flattened(moved, free)
    for vertex in np.flatnonzero(free):
        around = np.setdiff1d(rest.faces[(rest.faces == vertex).any(axis=1)], vertex)
        # of 5 beside the weight of 1e-6 that holds them where they were
        assert found[vertex] == pytest.approx(found[around].mean(axis=0), abs=1e-4)
    assert (found[~free] == rest.vertices[~free]).all()


def test_loose_pieces_move_with_the_nearest_piece():
    one = subdivide(torus(12, 8))
    small = Mesh(0.1 * one.vertices + [2.0, 0.0, 0.0], one.faces)
    count = len(one.vertices)
    both = Mesh(
        np.concatenate([one.vertices, small.vertices]),
        np.concatenate([one.faces, one.faces + count]),
    )
    body = elastic(both)
    weight = np.append(np.ones(count), np.zeros(count))
    shifted = both.vertices + np.array([0.0, 3.0, 0.0])
    found = body.deformed(body.interpolated(shifted, weight), Pull(shifted, weight), 0.05)
    assert found == pytest.approx(shifted, abs=0.02 * body.unit)


def test_the_energy_of_rigid_motions_is_zero_and_grows_with_stretching():
    mesh = icosphere(3)
    body = elastic(mesh)
    turned = mesh.vertices @ Rotation.random(rng=0).as_matrix().T + [1.0, 2.0, 3.0]
    assert body.energy(turned) == pytest.approx(0, abs=1e-12)
    little, much = (body.energy(mesh.vertices * [1, 1, share]) for share in (1.1, 1.3))
    assert 0 < little < much
    # the same for shapes of another size
    larger = elastic(Mesh(5 * mesh.vertices, mesh.faces))
    assert larger.energy(5 * mesh.vertices * [1, 1, 1.3]) == pytest.approx(much)
