import numpy as np

from esd.descriptors.sihks import sihks


def test_sihks_hardly_changes_with_scale(shape_spectrum):
    small = sihks(shape_spectrum)
    for factor in (0.5, 2.0, 4.0):
        change = np.abs(sihks(shape_spectrum.with_area(factor)) - small).max()
        assert (
            change < 0.01 * small.max()
        )  # finite range of times; HKS itself changes by the factor
