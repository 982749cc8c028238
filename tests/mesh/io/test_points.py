import numpy as np
import pytest

from esd.common import InputError
from esd.mesh.io.meshes import read_arrays


def pcd(form, body, fields="x y z", count=2):
    names = fields.split()
    return (
        f"# .PCD v0.7\nVERSION 0.7\nFIELDS {fields}\nSIZE{' 4' * len(names)}\n"
        f"TYPE{' F' * len(names)}\nCOUNT{' 1' * len(names)}\nWIDTH {count}\nHEIGHT 1\n"
        f"POINTS {count}\nDATA {form}\n"
    ).encode() + body


def test_clouds_of_pcl_are_read(tmp_path):
    path = tmp_path / "m.pcd"
    path.write_bytes(pcd("ascii", b"9 1 2 3\n9 4 5 6\n", "rgb x y z"))
    np.testing.assert_array_equal(read_arrays(path)[0], [[1, 2, 3], [4, 5, 6]])
    rows = np.array([[1, 2, 9, 3], [4, 5, 9, 6]], "<f4").tobytes()
    path.write_bytes(pcd("binary", rows, "x y rgb z"))
    vertices, faces = read_arrays(path)
    np.testing.assert_array_equal(vertices, [[1, 2, 3], [4, 5, 6]])
    assert len(faces) == 0


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"hello", "no line DATA"),
        (pcd("ascii", b"1 2\n3 4\n", "x y"), "no x, y and z, only x, y"),
        (pcd("binary_compressed", b""), "'binary_compressed'; save it as ascii"),
        (pcd("binary", bytes(12)), "announces 2 points, more than"),
        (pcd("ascii", b"1 2 3\n"), "announces 2 points, 1 were read"),
    ],
)
def test_clouds_that_cannot_be_used_are_refused(tmp_path, content, message):
    (tmp_path / "m.pcd").write_bytes(content)
    with pytest.raises(InputError, match=rf"m.pcd': .*{message}"):
        read_arrays(tmp_path / "m.pcd")


@pytest.mark.parametrize(
    "text",
    [
        "1,2.5,3\n4,5,6\n",
        "1;2,5;3\n4;5;6\n",
        "x y z\n1 2.5 3\n4 5 6\n",
        "2\n1 2.5 3\n4 5 6\n",
        "x, y, z\n1, 2.5, 3\n4, 5, 6",
    ],
)
def test_points_of_spreadsheets_have_other_signs_between_numbers(tmp_path, text):
    (tmp_path / "p.xyz").write_text(text)
    np.testing.assert_array_equal(read_arrays(tmp_path / "p.xyz")[0], [[1, 2.5, 3], [4, 5, 6]])
