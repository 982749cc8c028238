import numpy as np
import pytest

from esd.descriptors.gps import gps
from esd.descriptors.hks import heat_times, hks
from esd.descriptors.wks import wks


def test_hks_integrates_to_the_heat_trace(shape_spectrum):
    times = heat_times(shape_spectrum, count=20)
    trace = np.exp(-np.outer(shape_spectrum.eigenvalues, times)).sum(axis=0)
    np.testing.assert_allclose(
        shape_spectrum.mass @ hks(shape_spectrum, count=20), trace, rtol=1e-9
    )


def test_heat_times_are_as_the_paper_has_them(shape_spectrum):
    times = heat_times(shape_spectrum)
    assert len(times) == 100
    assert times[0] == pytest.approx(4 * np.log(10) / shape_spectrum.eigenvalues[-1])
    assert times[-1] == pytest.approx(4 * np.log(10) / shape_spectrum.eigenvalues[1])
    np.testing.assert_allclose(times[1:] / times[:-1], times[1] / times[0])


def test_scaling_laws(shape_spectrum):
    large = shape_spectrum.with_area(9.0)
    np.testing.assert_allclose(hks(large), hks(shape_spectrum) / 9, rtol=1e-9)
    np.testing.assert_allclose(wks(large), wks(shape_spectrum) / 9, rtol=1e-9)
    np.testing.assert_allclose(gps(large), gps(shape_spectrum), rtol=1e-9)
