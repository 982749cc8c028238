import numpy as np
import pytest

from esd.descriptors.wks import wave_energies, wks


def test_wks_integrates_to_one(shape_spectrum):
    assert wks(shape_spectrum).shape == (len(shape_spectrum.mass), 100)
    np.testing.assert_allclose(shape_spectrum.mass @ wks(shape_spectrum), 1, rtol=1e-9)


def test_wave_energies_are_even_in_the_logarithm_of_the_eigenvalue(shape_spectrum):
    low, high = np.log(shape_spectrum.eigenvalues[[1, -1]])
    energies, width = wave_energies(shape_spectrum)
    np.testing.assert_allclose(energies[[0, -1]], [low, high])
    assert width == pytest.approx(7 * (energies[1] - energies[0]))
    np.testing.assert_allclose(np.diff(energies), (high - low) / 99)
