import numpy as np
import pytest

from damaged import SPHERE, found
from esd.common import InputError
from esd.mesh.geometry import (
    surface_area,
)
from esd.mesh.repair.diagnose import diagnose
from esd.mesh.repair.repair import repair
from measures import signed_volume


def test_vertices_that_are_no_numbers_go_with_their_faces():
    vertices = SPHERE.vertices.copy()
    vertices[[5, 9]] = [[np.nan, 0, 0], [0, np.inf, 0]]
    assert found((vertices, SPHERE.faces))["non_finite_vertices"] == 2
    repaired = repair((vertices, SPHERE.faces))
    assert np.isfinite(repaired.shape.vertices).all()
    np.testing.assert_array_equal(np.flatnonzero(repaired.vertex_index < 0), [5, 9])
    values = repaired.carried_back(repaired.shape.vertices)
    np.testing.assert_array_equal(np.isnan(values).all(axis=1), repaired.vertex_index < 0)


@pytest.mark.parametrize(("factor", "shift"), [(1e200, 0), (1e-200, 0), (1e-310, 0), (1, 1e9)])
def test_extreme_coordinates_become_ordinary(factor, shift):
    vertices = SPHERE.vertices * factor + shift
    assert found((vertices, SPHERE.faces)) == {"extreme_coordinates": 1}
    mesh = repair((vertices, SPHERE.faces)).shape
    ratio = signed_volume(mesh) / surface_area(mesh) ** 1.5  # about 0.094 for a sphere
    assert ratio == pytest.approx(
        signed_volume(SPHERE) / surface_area(SPHERE) ** 1.5, rel=1e-6
    )  # 1e9 leaves seven digits, 1e-310 fourteen fewer than usual bits


@pytest.mark.parametrize(
    ("vertices", "faces", "message"),
    [
        ([["a", "b", "c"]], [[0, 0, 0]], "must be numbers"),
        (np.zeros((3, 2)), [[0, 1, 2]], r"`vertices` must have shape \(n, 3\)"),
        (np.zeros((3, 3)), [[0, 1]], r"`faces` must have shape \(m, 3\)"),
        (np.zeros((3, 3)), [[0.0, 1.0, 2.0]], "must be integers"),
    ],
)
def test_what_is_no_mesh_at_all_is_refused(vertices, faces, message):
    with pytest.raises(InputError, match=message):
        diagnose((vertices, faces))


def test_a_vertex_far_away_and_a_ground_plane_are_left_out(blob):
    far = blob.vertices.copy()
    far[0] *= 1e4
    diagnosis = diagnose((far, blob.faces))
    assert found((far, blob.faces))["spikes"] == 6  # the faces at that vertex of the torus
    assert diagnosis.severity == "serious"
    repaired = repair((far, blob.faces))
    assert surface_area(repaired.shape) == pytest.approx(surface_area(blob), rel=0.02)
    assert repaired.vertex_index[0] == -1

    count, (a, b) = len(blob.vertices), blob.faces[0, :2]
    ground = np.vstack([blob.vertices, [[30.0, 30, 0], [-30, 30, 0]]])
    faces = np.vstack([blob.faces, [[b, a, count], [a, count + 1, count]]])
    assert found((ground, faces))["spikes"] == 2
    assert surface_area(repair((ground, faces)).shape) == pytest.approx(surface_area(blob))
    assert "spikes" not in found(blob)
