import numpy as np
import pytest

from esd.common import InputError
from esd.datasets.deformation import deformed
from esd.mesh.mesh import Mesh
from esd.mesh.shapes import icosphere
from measures import signed_volume


def test_copies_keep_their_faces_and_are_not_turned_inside_out():
    mesh = icosphere(3)
    for seed in range(5):
        copy = deformed(mesh, seed=seed, strain=0.6)
        np.testing.assert_array_equal(copy.faces, mesh.faces)
        assert signed_volume(copy) > 0.3 * signed_volume(mesh)
        assert np.linalg.norm(copy.vertices - mesh.vertices, axis=1).mean() > 0.02


def test_equal_seeds_give_equal_copies_of_any_size_and_place():
    mesh = icosphere(2)
    first, again, other = (deformed(mesh, seed=seed).vertices for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert np.abs(first - other).max() > 0.01
    moved = deformed(Mesh(1000 * mesh.vertices + 5.0, mesh.faces), seed=1).vertices
    np.testing.assert_allclose(moved, 1000 * first, atol=1e-6)  # of a size of 2000


def test_without_strain_nothing_changes_but_the_place():
    mesh = icosphere(2)
    np.testing.assert_allclose(
        deformed(mesh, seed=0, strain=0.0).vertices, mesh.vertices, atol=1e-12
    )


def test_strains_that_fold_space_are_refused():
    with pytest.raises(InputError, match=r"`strain` must be from 0 to less than 1; got 1\.0"):
        deformed(icosphere(1), seed=0, strain=1.0)
