import numpy as np
import pytest

from esd.common import InputError
from esd.matching.refine import zoomout
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
    refined = zoomout(source, target, noisy, first=20, last=80, step=10)
    assert (noisy == truth).mean() < 0.6
    assert (refined == truth).mean() > 0.95


def test_missing_matches_are_filled(pair):
    source, target, truth = pair
    partial = np.where(np.arange(len(truth)) % 3 == 0, truth, -1)
    assert (zoomout(source, target, partial, first=20, step=10) == truth).mean() > 0.95


def test_impossible_refinements_are_refused(pair):
    source, target, truth = pair
    with pytest.raises(InputError, match="first ≤ last"):
        zoomout(source, target, truth, first=50, last=20)
    with pytest.raises(InputError, match="without a match"):
        zoomout(source, target, np.full(len(truth), -1))
