import pytest

from esd.datasets.collection import Collection
from knobbed import knobbed_shape


@pytest.fixture(scope="session")
def unregistered() -> Collection:
    """Five knobbed balls of which no two are known to correspond."""
    return Collection("knobbed", tuple(knobbed_shape(seed) for seed in range(5)))
