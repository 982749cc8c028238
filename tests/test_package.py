import subprocess
import sys

import pytest

import esd


def test_public_names_are_there():
    for name in esd.__all__:
        assert getattr(esd, name) is not None
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        esd.nothing  # noqa: B018


def test_importing_it_loads_no_other_package():
    code = "import sys, esd; sys.exit(', '.join({'numpy', 'scipy', 'torch'} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert not done.stderr.strip()
