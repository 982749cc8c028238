import pytest

import esd


def test_public_names_are_there():
    for name in esd.__all__:
        assert getattr(esd, name) is not None
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        esd.nothing  # noqa: B018
