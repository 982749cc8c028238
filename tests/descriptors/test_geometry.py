from dataclasses import replace

import numpy as np
import pytest

from esd.common import InputError
from esd.descriptors.geometry import cubic_spline, geometry_vector
from esd.spectral.spectrum import Spectrum


def test_splines_add_up_to_one_between_their_ends():
    x = np.linspace(-3, 3, 601)
    total = sum(cubic_spline(x - i) for i in range(-6, 7))
    np.testing.assert_allclose(total, 1, atol=1e-12)
    assert cubic_spline(np.array([0.0, 1, -1, 2, 5])) == pytest.approx([2 / 3, 1 / 6, 1 / 6, 0, 0])


def test_a_geometry_vector_holds_the_squared_eigenvectors_by_frequency():
    vectors = np.array([[1.0, 2.0], [1.0, -1.0], [1.0, 0.0]])
    shape_spectrum = Spectrum(np.array([0.0, 5.0]), vectors, np.ones(3) / 3, 1)
    values = geometry_vector(shape_spectrum, count=11, largest=10.0)
    expected = np.zeros((3, 11))
    expected[:, :2] = [4, 1]  # the constant mode, of frequency zero
    expected[:, 4:7] = vectors[:, 1:] ** 2 * [1, 4, 1]
    expected /= np.linalg.norm(expected, axis=1, keepdims=True)
    np.testing.assert_allclose(values, expected, atol=1e-12)


def test_geometry_vectors_know_no_signs_and_no_scale(shape_spectrum):
    signs = np.where(np.arange(60) % 3, 1, -1)
    values = geometry_vector(shape_spectrum)
    other = replace(shape_spectrum, eigenvectors=shape_spectrum.eigenvectors * signs).with_area(7.0)
    np.testing.assert_allclose(geometry_vector(other), values, rtol=1e-9, atol=1e-12)
    # by Weyl's law, the last knot lies near the last eigenvalue of any shape
    assert 0.6 < 0.99 * 4 * np.pi * 59 / shape_spectrum.eigenvalues[-1] < 1.5
    for arguments in ({"count": 1}, {"largest": 0.0}):
        with pytest.raises(InputError, match="two components or more and a positive `largest`"):
            geometry_vector(shape_spectrum, **arguments)
