import numpy as np

from esd.descriptors.gps import gps


def test_gps_is_the_green_function_at_a_distance(shape_spectrum):
    signature = gps(shape_spectrum, count=25)
    mean_square = shape_spectrum.mass @ signature**2
    np.testing.assert_allclose(mean_square, 1 / shape_spectrum.eigenvalues[1:26], rtol=1e-9)
