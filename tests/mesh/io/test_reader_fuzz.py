import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from esd.common import InputError
from esd.mesh.io.meshes import read_arrays, write_mesh
from esd.mesh.shapes import icosphere

FAST = settings(
    max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
SUFFIXES = ("off", "obj", "ply", "stl", "glb")


def is_read_or_refused(path):
    try:
        vertices, faces = read_arrays(path)
    except InputError as error:
        assert path.name in str(error)
        return
    assert vertices.ndim == 2
    assert faces.ndim == 2
    assert vertices.shape[1] == faces.shape[1] == 3


@pytest.mark.parametrize("suffix", [*SUFFIXES, "gltf", "xyz"])
@FAST
@given(content=st.binary(max_size=200))
def test_any_bytes_are_read_or_refused(tmp_path, suffix, content):
    path = tmp_path / f"any.{suffix}"
    path.write_bytes(content)
    is_read_or_refused(path)


@pytest.mark.parametrize("suffix", SUFFIXES)
@FAST
@given(
    places=st.lists(st.tuples(st.integers(0, 10**6), st.integers(0, 255)), min_size=1, max_size=8),
    end=st.integers(0, 10**6),
)
def test_damaged_files_are_read_or_refused(tmp_path, suffix, places, end):
    path = tmp_path / f"whole.{suffix}"
    if not path.exists():
        write_mesh(icosphere(0), path)
    content = np.frombuffer(path.read_bytes(), dtype=np.uint8).copy()
    for place, value in places:
        content[place % len(content)] = value
    damaged = tmp_path / f"damaged.{suffix}"
    damaged.write_bytes(content[: end % len(content) + 1 if end % 2 else None].tobytes())
    is_read_or_refused(damaged)
