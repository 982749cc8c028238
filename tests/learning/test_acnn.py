import numpy as np
import pytest
from scipy.linalg import eigh

from esd.learning.acnn import (
    AnisotropicPatches,
    anisotropic_patches,
    anisotropic_stiffness,
    heat_operator,
)
from esd.mesh.geometry import surface_area
from esd.mesh.mesh import Mesh
from esd.mesh.shapes import torus
from esd.spectral.laplacian import lumped_mass, stiffness

PATCHES = AnisotropicPatches()


def test_without_anisotropy_it_is_the_cotangent_laplacian(blob):
    for angle in (0.0, 0.7):
        found = anisotropic_stiffness(blob, angle=angle, anisotropy=0)
        assert abs(found - stiffness(blob)).max() < 1e-12


def test_stiffness_is_symmetric_and_annihilates_constants(blob):
    matrix = anisotropic_stiffness(blob, angle=0.7, anisotropy=100)
    assert abs(matrix - matrix.T).max() < 1e-14
    assert abs(matrix.sum(axis=1)).max() < 1e-12
    assert np.linalg.eigvalsh(matrix.toarray()).min() > -1e-12


def test_opposite_directions_add_up(blob):
    """D at an angle and across it are (1 + 1 / (1 + α)) times the identity together."""
    both = [anisotropic_stiffness(blob, angle=a, anisotropy=100) for a in (0.7, 0.7 + np.pi / 2)]
    assert abs(both[0] + both[1] - (1 + 1 / 101) * stiffness(blob)).max() < 1e-12


def test_a_torus_is_curved_most_around_its_tube():
    """Heat kept from flowing around the tube flows along it, and the other way."""
    mesh = torus(64, 32)
    x, y, z = mesh.vertices.T
    around, tube = np.arctan2(y, x), np.arctan2(z, np.hypot(x, y) - 1)
    energies = []
    for function in (np.sin(around), np.sin(tube)):
        for angle in (0.0, np.pi / 2):
            matrix = anisotropic_stiffness(mesh, angle=angle, anisotropy=100)
            energies.append(function @ matrix @ function)
    assert energies[0] > 50 * energies[1]  # 101, but for how well the direction is found
    assert energies[3] > 50 * energies[2]


def test_angles_are_counter_clockwise():
    """On the outside of a torus, x outward, y around and z up, tubes run along z."""
    mesh = torus(64, 32)
    operator = heat_operator(
        anisotropic_stiffness(mesh, angle=np.pi / 4, anisotropy=100),
        lumped_mass(mesh),
        4e-3 * surface_area(mesh),
    )
    assert mesh.vertices[0] == pytest.approx([1.4, 0, 0])
    _, y, z = mesh.vertices.T
    # slow along z turned by 45 degrees towards −y, so fast where y and z have one sign
    kernel = operator[[0]].toarray()[0]
    correlation = (kernel * y * z).sum() / np.sqrt((kernel * y**2).sum() * (kernel * z**2).sum())
    assert correlation > 0.5


@pytest.mark.parametrize("share", [3.2e-4, 1.6e-3])
def test_heat_operators_agree_with_all_eigenpairs(blob, share):
    matrix, mass = anisotropic_stiffness(blob, angle=0.7, anisotropy=100), lumped_mass(blob)
    time = share * surface_area(blob)
    values, vectors = eigh(matrix.toarray(), np.diag(mass))
    exact = (vectors * np.exp(-values * time)) @ vectors.T * mass
    found = heat_operator(matrix, mass, time)
    np.testing.assert_allclose(found.sum(axis=1), 1, atol=1e-12)
    off = abs(found - exact).sum(axis=1)  # of rows whose sum is one
    assert off.mean() < 0.04  # measured: 0.013 and 0.026, by the entries left out
    assert off.max() < 0.06  # measured: 0.025 and 0.041


def test_rows_sum_to_one_and_need_no_units(blob):
    operator = anisotropic_patches(blob, PATCHES)
    assert operator.shape == (80 * len(blob.vertices), len(blob.vertices))
    assert operator.dtype == np.float32
    assert operator.data.min() > 0
    np.testing.assert_allclose(operator.sum(axis=1), 1, atol=1e-6)
    assert np.diff(operator.indptr).max() == PATCHES.entries
    larger = anisotropic_patches(Mesh(1000 * blob.vertices + 5, blob.faces), PATCHES)
    assert abs(operator - larger).max() < 1e-4  # ties among the smallest entries kept


def test_patches_hold_the_largest_entries_of_each_kernel(blob):
    operator = anisotropic_patches(blob, PATCHES)
    mass = lumped_mass(blob)
    time = 3 / 5 * PATCHES.longest * surface_area(blob)
    matrix = anisotropic_stiffness(blob, angle=4 * np.pi / 16, anisotropy=100)
    kernel = heat_operator(matrix, mass, time)[[7]].toarray()[0]
    kernel[np.argsort(-kernel)[PATCHES.entries :]] = 0
    row = operator[[80 * 7 + 2 * 16 + 4]].toarray()[0]  # the third time, the fifth angle
    assert abs(row - kernel / kernel.sum()).sum() < 0.04  # three steps instead of one: 0.021
