from dataclasses import replace

import numpy as np
import pytest

from esd.common import InputError
from esd.matching.functional_map import fitted_map, functional_map, spectral_rows
from esd.mesh.mesh import Mesh
from esd.spectral.spectrum import spectrum


def test_the_identity_is_the_unit_matrix(blob):
    eigenpairs = spectrum(blob, 12)
    found = functional_map(eigenpairs, eigenpairs, np.arange(len(blob.vertices)), size=10)
    np.testing.assert_allclose(found, np.eye(10), atol=1e-9)


def test_an_isometry_gives_an_orthogonal_matrix_and_equal_rows(blob):
    order = np.random.default_rng(0).permutation(len(blob.vertices))
    other = Mesh(3 * blob.vertices[order], np.argsort(order)[blob.faces])  # scaled, renumbered
    spectra = spectrum(blob, 12), spectrum(other, 12)
    truth = np.argsort(order)
    matrix = functional_map(*spectra, truth, size=10)
    np.testing.assert_allclose(matrix @ matrix.T, np.eye(10), atol=1e-6)
    here, there = spectral_rows(*spectra, matrix)
    np.testing.assert_allclose(here, there[truth], atol=1e-5)


def test_vertices_without_a_match_take_no_part(blob):
    eigenpairs = spectrum(blob, 5)
    index = np.arange(len(blob.vertices))
    index[::2] = -1
    matrix = functional_map(eigenpairs, eigenpairs, index, size=5)
    half = eigenpairs.mass[1::2].sum() / eigenpairs.mass.sum()
    assert matrix[0, 0] == pytest.approx(half)  # the share of the area with a match
    with pytest.raises(InputError, match="The map has no match"):
        functional_map(eigenpairs, eigenpairs, np.full(len(index), -1), size=5)
    with pytest.raises(InputError, match="`size` must be from 1 to 5, the eigenpairs; got 6"):
        functional_map(eigenpairs, eigenpairs, index, size=6)


def test_the_map_fitted_to_samples_is_that_of_all_vertices(blob):
    """Of a shape to itself it is the identity, although a sample's functions are not orthogonal."""
    whole = spectrum(blob, 20)
    chosen = np.random.default_rng(0).choice(len(blob.vertices), 200, replace=False)
    sample = replace(
        whole, eigenvectors=whole.eigenvectors[chosen], mass=np.full(len(chosen), 1 / len(chosen))
    )
    every = np.arange(len(chosen))
    np.testing.assert_allclose(
        fitted_map(sample, sample, every, size=20), np.eye(20), atol=1e-4
    )  # the ridge of 1e-6, over the least eigenvalue of the overlap
    projected = functional_map(sample, sample, every, size=20)
    assert np.abs(projected - np.eye(20)).max() > 0.05
