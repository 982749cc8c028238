import numpy as np
import pytest

from esd.common import InputError
from esd.mesh.convert import as_mesh
from esd.mesh.mesh import Mesh
from esd.mesh.repair.repair import repair

TRIANGLE = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])


@pytest.mark.parametrize(
    ("vertices", "faces", "message"),
    [
        (TRIANGLE.T[:, :2], [[0, 1, 2]], r"shape \(n, 3\); got \(3, 2\). Transpose it\?"),
        (TRIANGLE, np.zeros((3, 5), int), r"shape \(m, 3\); got \(3, 5\). Transpose it\?"),
        (TRIANGLE * [1, np.nan, 1], [[0, 1, 2]], "must be finite; 3 are not"),
        (TRIANGLE, [[0, 1, 3]], r"from 0 to 2; 1 do not, the first is face 0: \[0, 1, 3\]"),
        (TRIANGLE, [[0, 1, -1]], "from 0 to 2"),
        (TRIANGLE, np.zeros((0, 3), int), "no faces"),
        (TRIANGLE, [[0.0, 1.0, 2.0]], "must be integers"),
        ([["a", "b", "c"]], [[0, 0, 0]], "must be numbers"),
    ],
)
def test_bad_arrays_are_refused(vertices, faces, message):
    with pytest.raises(InputError, match=message):
        Mesh(vertices, faces)


def test_arrays_are_copied_and_read_only():
    vertices = TRIANGLE.copy()
    mesh = Mesh(vertices, [[0, 1, 2]])
    vertices[0] = 9
    assert mesh.vertices[0, 0] == 0
    with pytest.raises(ValueError, match="read-only"):
        mesh.vertices[0] = 1


def test_rows_of_different_lengths_are_refused_in_plain_words():
    triangle = [[0, 0, 0], [1, 0, 0], [0, 1, 0]]
    for make in (as_mesh, repair):
        for arrays, message in (
            (([[0, 0, 0], [1, 1]], [[0, 1, 2]]), "got words, or rows of different lengths"),
            ((triangle, [[0, 1, 2], [0, 1]]), "Cut polygons into triangles first"),
        ):
            with pytest.raises(InputError, match=message):
                make(arrays)
