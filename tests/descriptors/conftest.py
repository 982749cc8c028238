import pytest

from esd.spectral.spectrum import spectrum


@pytest.fixture
def shape_spectrum(blob):
    return spectrum(blob, 60)
