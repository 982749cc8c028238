import pytest

from esd.common import InputError
from esd.mesh.io.meshes import read_arrays


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("hello\n", "does not begin with OFF"),
        ("OFF BINARY\n", "binary OFF"),
        ("OFF\n-3 1 0\n", "announces -3 vertices"),
        ("OFF\n3 1 0\n0 0 0\n1 0 0\n", "announces 3 vertices, 2 were read"),
        ("OFF\n1 1 0\n0 0 0\n", "announces 1 faces, 0 were read"),
        ("OFF\n1 1 0\n0 0 0\n-3 0 0 0\n", "negative number of corners"),
        ("OFF\n1 1 0\n0 0 0\n3 0 0\n", "fewer corners"),
    ],
)
def test_off_files_that_cannot_be_used_are_refused(tmp_path, text, message):
    (tmp_path / "m.off").write_text(text)
    with pytest.raises(InputError, match=rf"m.off': .*{message}"):
        read_arrays(tmp_path / "m.off")
