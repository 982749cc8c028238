import numpy as np
import pytest
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from esd.common import InputError
from esd.matching.confidence import Judgement
from esd.matching.correspondence import Correspondence
from esd.mesh.geometry import surface_area, vertex_areas
from esd.mesh.mesh import Mesh
from esd.mesh.shapes import grid, icosphere, torus
from esd.viewing.scene import mean_error, scene


def identity(mesh: Mesh, **changes) -> Correspondence:
    count = len(mesh.vertices)
    values = {
        "target_index": np.arange(count),
        "distance": np.zeros(count),
        "confidence": np.ones(count),
    }
    return Correspondence(**(values | changes))


def field(shown, name):
    return next(field for field in shown.meta["fields"] if field["name"] == name)


def test_up_is_guessed_from_the_longest_side():
    tall = grid(5, 4)
    for order, up in (((0, 1, 2), "y"), ((2, 1, 0), "z")):
        mesh = Mesh(tall.vertices[:, order] * (1 + np.arange(3)), tall.faces)
        assert scene(mesh, mesh, identity(mesh)).meta["up"] == up
        assert scene(mesh, mesh, identity(mesh), up="-x").meta["up"] == "-x"


def test_the_target_is_turned_back_by_the_map(blob):
    turn = Rotation.from_euler("xyz", [2.0, -0.7, 1.1]).as_matrix()
    turned = Mesh(5 * blob.vertices @ turn.T + 3, blob.faces)
    shown = scene(blob, turned, identity(blob))
    np.testing.assert_allclose(np.reshape(shown.meta["rotation"], (3, 3)), turn.T, atol=1e-6)


def test_scales_are_the_same_for_all_maps(blob):
    half = identity(blob, confidence=np.full(len(blob.vertices), 0.5))
    for match in (identity(blob), half):
        shown = scene(blob, blob, match, error=np.full(len(blob.vertices), 0.01))
        assert [(f["name"], f["low"], f["high"]) for f in shown.meta["fields"]] == [
            ("confidence", 0, 1),
            ("error", 0, 0.25),
            ("distance", 0, 1),
            ("stretch", -3, 3),
        ]


def test_distances_end_at_a_round_number(blob):
    distance = np.linspace(0, 0.34, len(blob.vertices))
    shown = scene(blob, blob, identity(blob, distance=distance))
    assert field(shown, "distance")["high"] == 0.5


def test_stretch_is_that_of_the_surface():
    """A sphere drawn out to an ellipsoid of the same area: where it is thin, it is larger."""
    sphere = icosphere(4)
    long = Mesh(sphere.vertices * [1, 1, 3], sphere.faces)
    stretch = scene(sphere, long, identity(sphere)).arrays["stretch"]
    equator = np.abs(sphere.vertices[:, 2]) < 0.05
    poles = np.abs(sphere.vertices[:, 2]) > 0.99
    total = scene(sphere, sphere, identity(sphere)).arrays["stretch"]
    np.testing.assert_allclose(total, 0, atol=1e-5)  # single precision
    scale = np.log2(3) - stretch[equator].mean()  # the equator grows threefold, less the scaling
    # the poles keep their size before the scaling; both are means over faces of finite size
    assert stretch[poles].mean() == pytest.approx(-scale, abs=0.1)


def test_vertices_without_a_counterpart_are_counted_and_have_no_values(blob):
    index = np.arange(len(blob.vertices))
    index[::4] = -1
    distance = np.where(index < 0, np.inf, 0.5)
    shown = scene(blob, blob, identity(blob, target_index=index, distance=distance), model="m")
    # shares of the area; target vertices near images have a counterpart
    areas = vertex_areas(blob)
    there = areas[shown.arrays["comes_from"] < 0].sum() / areas.sum()
    expected = [areas[::4].sum() / areas.sum(), there]
    np.testing.assert_allclose(shown.meta["lacking"], expected, rtol=1e-9)
    assert ("Model", "m") in shown.meta["statistics"]
    assert np.isnan(shown.arrays["distance"][::4]).all()
    comes_from = shown.arrays["comes_from"]
    np.testing.assert_array_equal(comes_from[index[index >= 0]], index[index >= 0])


def test_target_vertices_far_from_all_images_show_nothing(blob):
    matched = blob.vertices[:, 0] > 0
    index = np.where(matched, np.arange(len(blob.vertices)), -1)
    comes_from = scene(blob, blob, identity(blob, target_index=index)).arrays["comes_from"]
    away = KDTree(blob.vertices[matched]).query(blob.vertices)[0] / np.sqrt(surface_area(blob))
    assert (away > 0.2).any()
    assert (comes_from[away > 0.2] == -1).all()
    assert (comes_from[matched] >= 0).all()


def test_the_worst_places_are_apart_and_worst_first(blob):
    confidence = np.ones(len(blob.vertices))
    wrong = [10, 300]
    for vertex, value in zip(wrong, (0.2, 0.1), strict=True):
        confidence[np.linalg.norm(blob.vertices - blob.vertices[vertex], axis=1) < 0.2] = value
    places = scene(blob, blob, identity(blob, confidence=confidence)).meta["places"]
    assert [round(place["value"], 1) for place in places[:2]] == [0.1, 0.2]
    for place, vertex in zip(places, wrong[::-1], strict=False):
        assert np.linalg.norm(blob.vertices[place["vertex"]] - blob.vertices[vertex]) < 0.3
    assert scene(blob, blob, identity(blob)).meta["places"] == []
    error = 1 - confidence
    by_error = scene(blob, blob, identity(blob), error=error).meta["places"]
    assert by_error[0]["field"] == "error"
    assert by_error[0]["value"] == pytest.approx(0.9, abs=1e-6)


def test_the_mean_error_is_by_area_and_of_what_is_known(blob):
    error = np.full(len(blob.vertices), np.nan)
    assert mean_error(blob, error) is None
    error[3:5] = 0.1, 0.3
    a, b = vertex_areas(blob)[3:5]
    assert mean_error(blob, error) == pytest.approx((0.1 * a + 0.3 * b) / (a + b), rel=1e-6)
    shown = scene(blob, blob, identity(blob), error=error)
    assert dict(shown.meta["statistics"])["Mean error"].endswith("% of √area")


def test_the_verdict_is_the_map_s_own_or_follows_from_the_confidence(blob):
    assert scene(blob, blob, identity(blob)).meta["verdict"]["word"] == "good"
    doubt = identity(blob, confidence=np.full(len(blob.vertices), 0.7))
    assert scene(blob, blob, doubt).meta["verdict"]["word"] == "doubtful"
    own = identity(blob, judgement=Judgement("failed", 0.2, 0.1, {"embedding": 1.0}, True))
    shown = scene(blob, blob, own)
    assert shown.meta["verdict"]["advice"].startswith("The map is not to be trusted")
    own = Judgement("failed", 0.2, 1.0, unmatched=0.3, not_repaired="two holes")
    advice = scene(blob, blob, identity(blob, judgement=own)).meta["verdict"]["advice"]
    assert "30% of the source" in advice
    assert advice.endswith("Not repaired: two holes.")
    assert ("Candidate", "embedding") in shown.meta["statistics"]
    assert ("Mirrored", "the source, before it was matched") in shown.meta["statistics"]
    unknown = identity(blob, confidence=np.full(len(blob.vertices), np.nan))
    assert scene(blob, blob, unknown).meta["verdict"] is None


def test_what_cannot_be_shown_is_refused():
    mesh = torus(7, 5)
    with pytest.raises(InputError, match="`up` must be one of x, -x, y, -y, z, -z; got 'w'"):
        scene(mesh, mesh, identity(mesh), up="w")
    with pytest.raises(InputError, match=r"`error` must have shape \(35,\)"):
        scene(mesh, mesh, identity(mesh), error=np.zeros(3))


def test_packed_arrays_are_aligned(blob):
    shown = scene(blob, blob, identity(blob))
    meta, content = shown.packed()
    for name, kind, start, size in meta["arrays"]:
        assert start % int(kind[1]) == 0
        found = np.frombuffer(content, f"<{kind}", size, start)
        np.testing.assert_array_equal(found, shown.arrays[name].ravel())
