import numpy as np
import pytest

from esd.common import InputError
from esd.matching.functional_map import functional_map, spectral_rows
from esd.matching.refine import LARGEST_WEIGHT, LEAST_WEIGHT, zoomout
from esd.mesh.mesh import Mesh
from esd.spectral.spectrum import spectrum


@pytest.fixture
def pair(blob):
    """A shape, itself renumbered and turned, and the true map."""
    order = np.random.default_rng(0).permutation(len(blob.vertices))
    place = np.argsort(order)
    turned = Mesh(blob.vertices[order][:, [1, 2, 0]], place[blob.faces])
    return spectrum(blob, 80), spectrum(turned, 80), place


def test_noisy_maps_become_the_true_one(pair):
    source, target, truth = pair
    generator = np.random.default_rng(1)
    noisy = np.where(generator.random(len(truth)) < 0.5, truth, generator.permutation(truth))
    refined = zoomout(source, target, noisy, sizes=range(20, 81, 10))
    assert (noisy == truth).mean() < 0.6
    assert (refined == truth).mean() > 0.95


def test_missing_matches_are_filled(pair):
    source, target, truth = pair
    partial = np.where(np.arange(len(truth)) % 3 == 0, truth, -1)
    assert (zoomout(source, target, partial, sizes=range(20, 81, 10)) == truth).mean() > 0.95


def test_embeddings_keep_a_map_that_the_spectrum_would_spoil(blob):
    """One half of the target is swollen: its eigenfunctions are others, its points are not."""
    swollen = blob.vertices * np.where(blob.vertices[:, :1] > 0, 1.6, 1.0)
    spectra = spectrum(blob, 80), spectrum(Mesh(swollen, blob.faces), 80)
    truth = np.arange(len(swollen))
    embeddings = blob.vertices, blob.vertices
    alone = zoomout(*spectra, truth, sizes=(20, 40, 80))
    kept = zoomout(*spectra, truth, sizes=(20, 40, 80), embeddings=embeddings, weight=4.0)
    assert (alone == truth).mean() < 0.5
    assert (kept == truth).mean() > 0.8


def test_bijective_refinement_reaches_more_of_the_target(pair):
    source, target, truth = pair
    generator = np.random.default_rng(1)
    noisy = np.where(generator.random(len(truth)) < 0.4, truth, generator.permutation(truth))
    both = zoomout(source, target, noisy, sizes=(20, 40, 80), bijective=True)
    assert (both == truth).mean() > 0.95


def test_functional_map_of_an_isometry_is_orthogonal_and_diagonal_up_to_sign(pair):
    source, target, truth = pair
    functional = functional_map(source, target, truth, size=30)
    np.testing.assert_allclose(functional @ functional.T, np.eye(30), atol=1e-8)
    np.testing.assert_allclose(np.abs(functional), np.eye(30), atol=1e-6)
    rows, candidates = spectral_rows(source, target, functional)
    np.testing.assert_allclose(rows, candidates[truth], atol=1e-6)


def test_impossible_refinements_are_refused(pair):
    source, target, truth = pair
    with pytest.raises(InputError, match="must be ascending"):
        zoomout(source, target, truth, sizes=(50, 20))
    with pytest.raises(InputError, match="has no match"):
        zoomout(source, target, np.full(len(truth), -1))
    with pytest.raises(InputError, match=r"for each vertex of the source, .*; got shape \(3,\)"):
        zoomout(source, target, truth[:3])
    with pytest.raises(InputError, match="from 1 to 80"):
        functional_map(source, target, truth, size=81)


def test_embeddings_count_more_by_default_between_shapes_that_are_not_isometric(blob):
    swollen = blob.vertices * np.where(blob.vertices[:, :1] > 0, 1.6, 1.0)
    spectra = spectrum(blob, 80), spectrum(Mesh(swollen, blob.faces), 80)
    truth = np.arange(len(swollen))
    noise = 0.02 * np.random.default_rng(0).standard_normal((2, *swollen.shape))
    embeddings = blob.vertices + noise[0], blob.vertices + noise[1]
    by_default, least, largest = (
        zoomout(*spectra, truth, sizes=(20, 40, 80), embeddings=embeddings, weight=weight)
        for weight in (None, LEAST_WEIGHT, LARGEST_WEIGHT)
    )
    np.testing.assert_array_equal(by_default, largest)
    assert (by_default == truth).mean() > (least == truth).mean()
    same = spectra[0], spectra[0]
    by_default, least = (
        zoomout(*same, truth, sizes=(20, 40, 80), embeddings=embeddings, weight=weight)
        for weight in (None, LEAST_WEIGHT)
    )
    np.testing.assert_array_equal(by_default, least)
