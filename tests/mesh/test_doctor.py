import sys

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from esd.common import InputError
from esd.mesh.geometry import (
    components,
    is_consistently_oriented,
    is_referenced,
    surface_area,
)
from esd.mesh.mesh import Mesh, PointCloud
from esd.mesh.repair.diagnose import diagnose
from esd.mesh.repair.repair import repair
from esd.mesh.shapes import grid, icosphere, torus
from esd.mesh.topology import boundary_edges
from esd.spectral.spectrum import spectrum
from measures import signed_volume

SPHERE = icosphere(3)
COUNT = len(SPHERE.vertices)


def found(source, **options) -> dict[str, int]:
    return {finding.kind: finding.count for finding in diagnose(source, **options).findings}


def soup(mesh: Mesh) -> tuple[np.ndarray, np.ndarray]:
    """Each face with corners of its own, as in an STL file."""
    return mesh.vertices[mesh.faces].reshape(-1, 3), np.arange(mesh.faces.size).reshape(-1, 3)


def joined(*meshes: Mesh) -> tuple[np.ndarray, np.ndarray]:
    start = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    return (
        np.concatenate([mesh.vertices for mesh in meshes]),
        np.concatenate([mesh.faces + s for mesh, s in zip(meshes, start, strict=False)]),
    )


def touching_spheres() -> Mesh:
    """Two spheres that share one vertex: the highest of the one is the lowest of the other."""
    other = SPHERE.vertices * [1, 1, -1] + [0, 0, 2 * SPHERE.vertices[:, 2].max()]
    top = int(SPHERE.vertices[:, 2].argmax())
    faces = SPHERE.faces[:, ::-1] + COUNT
    faces[faces == top + COUNT] = top
    return Mesh(np.concatenate([SPHERE.vertices, other]), np.concatenate([SPHERE.faces, faces]))


def test_a_sound_mesh_has_nothing_wrong_and_stays_as_it_is():
    for mesh in (SPHERE, torus(24, 16)):
        diagnosis = diagnose(mesh)
        assert diagnosis.in_a_line() == "nothing wrong"
        assert diagnosis.severity == "harmless"
        for everything in (False, True):
            repaired = repair(mesh, everything=everything)
            np.testing.assert_array_equal(repaired.shape.vertices, mesh.vertices)
            np.testing.assert_array_equal(repaired.shape.faces, mesh.faces)
            np.testing.assert_array_equal(repaired.vertex_index, np.arange(len(mesh.vertices)))
            assert not repaired.done


def test_findings_say_how_many_how_bad_and_what_to_do():
    finding = diagnose(soup(SPHERE)).findings[0]
    assert finding.what == f"{3 * len(SPHERE.faces) - COUNT} vertices doubled along seams"
    assert finding.severity == "serious"
    assert "torn" in finding.effect
    assert "joined" in finding.remedy
    assert finding.always_repaired
    assert diagnose(soup(SPHERE)).severity == "serious"


def test_seams_are_joined_and_every_corner_keeps_a_vertex():
    vertices, faces = soup(SPHERE)
    repaired = repair((vertices, faces))
    assert len(np.unique(repaired.vertex_index)) == COUNT
    np.testing.assert_array_equal(repaired.shape.vertices[repaired.vertex_index], vertices)
    assert len(boundary_edges(repaired.shape)) == 0
    assert repaired.compacted().shape.vertices.shape == (COUNT, 3)
    assert diagnose(repaired.compacted().shape).findings == ()


def test_sheets_that_only_lie_upon_each_other_are_not_joined():
    flat = grid(20, 20)
    faces = flat.faces[~np.isin(flat.faces, [19, 380]).any(axis=1)]  # ears: all corners on the rim
    twice = (np.tile(flat.vertices, (2, 1)), np.concatenate([faces, faces[:, ::-1] + 400]))
    closed = repair(twice)  # a pillow: its two sheets are joined along their rims alone
    assert len(boundary_edges(closed.shape)) == 0
    assert int((closed.vertex_index[400:] >= 400).sum()) == 18 * 18


def test_vertices_that_are_no_numbers_go_with_their_faces():
    vertices = SPHERE.vertices.copy()
    vertices[[5, 9]] = [[np.nan, 0, 0], [0, np.inf, 0]]
    assert found((vertices, SPHERE.faces))["non_finite_vertices"] == 2
    repaired = repair((vertices, SPHERE.faces))
    assert np.isfinite(repaired.shape.vertices).all()
    np.testing.assert_array_equal(np.flatnonzero(repaired.vertex_index < 0), [5, 9])
    values = repaired.carried_back(repaired.shape.vertices)
    np.testing.assert_array_equal(np.isnan(values).all(axis=1), repaired.vertex_index < 0)


def test_faces_without_vertices_are_refused_unless_all_is_to_be_repaired():
    broken = (SPHERE.vertices, np.concatenate([SPHERE.faces, [[0, 1, COUNT], [0, -1, 2]]]))
    assert found(broken)["missing_vertices"] == 2
    with pytest.raises(InputError, match="must hold indices"):
        repair(broken)
    np.testing.assert_array_equal(repair(broken, everything=True).shape.faces, SPHERE.faces)


@pytest.mark.parametrize(("factor", "shift"), [(1e200, 0), (1e-200, 0), (1e-310, 0), (1, 1e9)])
def test_extreme_coordinates_become_ordinary(factor, shift):
    vertices = SPHERE.vertices * factor + shift
    assert found((vertices, SPHERE.faces)) == {"extreme_coordinates": 1}
    mesh = repair((vertices, SPHERE.faces)).shape
    ratio = signed_volume(mesh) / surface_area(mesh) ** 1.5  # about 0.094 for a sphere
    assert ratio == pytest.approx(
        signed_volume(SPHERE) / surface_area(SPHERE) ** 1.5, rel=1e-6
    )  # 1e9 leaves seven digits, 1e-310 fourteen fewer than usual bits


def test_faces_that_are_twice_there_or_collapsed_go():
    more = np.concatenate([SPHERE.faces, SPHERE.faces[:4], SPHERE.faces[4:6, ::-1], [[3, 3, 7]]])
    kinds = found((SPHERE.vertices, more))
    assert kinds == {"collapsed_faces": 1, "duplicate_faces": 6}
    np.testing.assert_array_equal(repair((SPHERE.vertices, more)).shape.faces, SPHERE.faces)


@pytest.mark.parametrize("share", [0.1, 0.5])
def test_faces_become_consistently_oriented_and_outward(share):
    turned = np.random.default_rng(0).random(len(SPHERE.faces)) < share
    faces = np.where(turned[:, None], SPHERE.faces[:, ::-1], SPHERE.faces)
    assert "inconsistent_winding" in found((SPHERE.vertices, faces))
    mesh = repair((SPHERE.vertices, faces)).shape
    assert is_consistently_oriented(mesh)
    assert signed_volume(mesh) == pytest.approx(signed_volume(SPHERE))


def test_a_mesh_turned_inside_out_is_turned_back():
    inside_out = Mesh(SPHERE.vertices, SPHERE.faces[:, ::-1])
    assert found(inside_out) == {"inside_out_pieces": 1}
    assert signed_volume(repair(inside_out).shape) > 0
    flat = grid(30, 30)  # has no inside
    assert "inside_out_pieces" not in found(Mesh(flat.vertices, flat.faces[:, ::-1]))


def test_a_moebius_strip_is_told():
    count = 200
    angle = 2 * np.pi * np.arange(count) / count
    radius = 1 + 0.3 * np.outer([-1, 1], np.cos(angle / 2))
    height = 0.3 * np.outer([-1, 1], np.sin(angle / 2))
    vertices = np.stack([radius * np.cos(angle), radius * np.sin(angle), height], axis=2)
    low = np.arange(count)
    after = np.append(low[1:], count)  # the strip closes with its edges exchanged
    above = np.append(low[1:] + count, 0)
    faces = np.concatenate(
        [np.stack([low, after, low + count], 1), np.stack([after, above, low + count], 1)]
    )
    kinds = found((vertices.reshape(-1, 3), faces))
    assert kinds["one_sided_pieces"] == 1
    assert kinds["holes"] == 1  # its one rim


def test_parts_that_touch_at_a_vertex_are_cut_apart():
    mesh = touching_spheres()
    assert found(mesh) == {
        "non_manifold_vertices": 1,
        "loose_pieces": 1,
        "unreferenced_vertices": 1,
    }
    repaired = repair(mesh)
    assert components(repaired.shape).max() == 0  # the other sphere is left out
    assert int(is_referenced(repaired.shape).sum()) == COUNT
    both = repair(mesh, all_pieces=True)
    assert components(both.shape).max() == 1
    assert found(both.shape) == {"loose_pieces": 1, "unreferenced_vertices": 1}
    assert both.original_index[-1] == int(SPHERE.vertices[:, 2].argmax())


def test_an_edge_of_three_faces_is_cut():
    a, b = SPHERE.faces[0, :2]
    fin = (
        np.concatenate([SPHERE.vertices, [2 * SPHERE.vertices[a]]]),
        np.concatenate([SPHERE.faces, [[a, b, COUNT]]]),
    )
    assert found(fin)["non_manifold_edges"] == 1
    for everything in (False, True):
        repaired = repair(fin, everything=everything)
        assert "non_manifold_edges" in repaired.done
        assert "non_manifold_edges" not in found(repaired.shape)
        assert (repaired.vertex_index[:COUNT] >= 0).all()  # the fin is dropped, not the sphere
        np.testing.assert_array_equal(repaired.shape.faces, SPHERE.faces)


def test_edges_stay_where_cutting_them_would_take_the_shape_apart():
    # three sheets of equal size along a common edge: none of them is the shape
    flat = grid(20, 20)
    shared = np.flatnonzero(flat.vertices[:, 0] == flat.vertices[:, 0].min())
    vertices, faces = [flat.vertices], [flat.faces]
    for i, angle in enumerate((2.0, 4.0)):
        x, y, _ = (flat.vertices - flat.vertices.min(axis=0)).T
        moved = np.stack([x * np.cos(angle), y, x * np.sin(angle)], axis=1)
        index = np.arange(400) + 400 * (i + 1)
        index[shared] = shared
        vertices.append(moved + flat.vertices.min(axis=0))
        faces.append(index[flat.faces])
    fan = (np.concatenate(vertices), np.concatenate(faces))
    assert found(fan)["non_manifold_edges"] == 19
    repaired = repair(fan)
    assert "non_manifold_edges" not in repaired.done
    assert len(repaired.shape.faces) == 3 * len(flat.faces)
    assert len(repair(fan, everything=True).shape.faces) == len(flat.faces)


def test_small_holes_are_filled_and_large_ones_are_not():
    pierced = Mesh(SPHERE.vertices, SPHERE.faces[(SPHERE.faces != 0).all(axis=1)])
    assert found(pierced)["holes"] == 1
    filled = repair(pierced, everything=True)
    assert len(boundary_edges(filled.shape)) == 0
    assert is_consistently_oriented(filled.shape)
    assert (SPHERE.faces == filled.original_index[-1]).any()
    bowl = Mesh(SPHERE.vertices, SPHERE.faces[SPHERE.vertices[SPHERE.faces, 2].mean(axis=1) < 0.2])
    assert diagnose(bowl).severity == "serious"
    assert len(boundary_edges(repair(bowl, everything=True).shape)) > 0


def test_of_loose_pieces_the_largest_is_kept():
    small = Mesh(SPHERE.vertices / 2 + 5, SPHERE.faces)
    pair = joined(small, SPHERE)
    finding = diagnose(pair).findings[0]
    assert (finding.kind, finding.count) == ("loose_pieces", 1)
    assert finding.share == pytest.approx(1 / 5)  # a quarter of the area of the other
    repaired = repair(pair)
    np.testing.assert_array_equal(repaired.vertex_index >= 0, np.arange(2 * COUNT) >= COUNT)
    assert repaired.lost == 1 / 2  # the other piece is as fine, and far away
    both = repair(pair, all_pieces=True)
    assert components(both.shape).max() == 1
    assert both.lost == 0


def test_only_the_piece_that_is_kept_says_whether_the_shape_was_inside_out():
    crumb = Mesh(SPHERE.vertices / 10 + 5, SPHERE.faces)
    turned = [Mesh(mesh.vertices, mesh.faces[:, ::-1]) for mesh in (SPHERE, crumb)]
    assert repair(joined(turned[0], crumb)).is_flipped
    assert not repair(joined(SPHERE, turned[1])).is_flipped
    one_other = turned[0].faces.copy()
    one_other[7] = one_other[7, ::-1]
    assert repair((SPHERE.vertices, one_other)).is_flipped
    one_other = SPHERE.faces.copy()
    one_other[7] = one_other[7, ::-1]
    assert not repair((SPHERE.vertices, one_other)).is_flipped


@pytest.mark.parametrize("scale", [1.0, 1000.0])
def test_seams_are_joined_where_rounding_moved_them_apart(scale):
    upper = SPHERE.vertices[SPHERE.faces].mean(axis=1)[:, 2] > 0
    noise = 1e-7 * scale * np.random.default_rng(0).uniform(-1, 1, SPHERE.vertices.shape)
    vertices = np.concatenate([scale * SPHERE.vertices, scale * SPHERE.vertices + noise])
    faces = np.where(upper[:, None], SPHERE.faces, SPHERE.faces + COUNT)
    repaired = repair((vertices, faces))
    assert len(boundary_edges(repaired.shape)) == 0
    assert len(repaired.shape.faces) == len(SPHERE.faces)
    moved = repaired.shape.vertices[repaired.vertex_index] - vertices
    used = repaired.vertex_index >= 0
    assert np.abs(moved[used]).max() < 2e-7 * scale
    apart = (vertices + np.repeat([[0.0], [1e-4 * scale]], COUNT, axis=0), faces)
    assert len(boundary_edges(repair(apart).shape)) > 0  # no rounding: they stay


def collapsed_region(rounds):
    """A sphere some of whose neighbouring vertices lie in one place."""
    vertices, near = SPHERE.vertices.copy(), np.array([5])
    for _ in range(rounds):
        near = np.unique(SPHERE.faces[np.isin(SPHERE.faces, near).any(axis=1)])
    vertices[near] = vertices[5]
    return Mesh(vertices, SPHERE.faces)


@pytest.mark.parametrize(
    "mesh",
    [
        collapsed_region(1),
        collapsed_region(2),
    ],
    ids=["ring", "two rings"],
)
def test_edges_without_length_are_collapsed(mesh):
    assert found(mesh)["zero_length_edges"] > 0
    with pytest.raises(InputError, match="cut vertices off; repair the mesh first"):
        spectrum(mesh, 20)
    repaired = repair(mesh)
    assert "zero_length_edges" not in found(repaired.shape)
    np.testing.assert_array_equal(
        mesh.vertices[repaired.original_index[repaired.vertex_index]], mesh.vertices
    )
    exact = 2 * 4 * np.pi  # l (l + 1) at unit area; rounded to a tenth the sphere is rough
    values = spectrum(repaired.compacted().shape, 20).eigenvalues
    assert values[0] == 0
    np.testing.assert_allclose(values[1:4], exact, rtol=0.15)


def test_a_file_that_is_refused_is_named(tmp_path):
    path = tmp_path / "bad.off"
    path.write_text("OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 7\n")
    with pytest.raises(InputError, match=r"bad.off': `faces` must hold indices from 0 to 2"):
        repair(path)


def test_slivers_folds_and_few_vertices_are_told():
    flat = Mesh(SPHERE.vertices * [1, 1, 1e-4], SPHERE.faces)
    assert {"slivers", "folded_edges"} & set(found(flat))
    rough = np.random.default_rng(0).standard_normal((COUNT, 1)) * 0.3
    assert "folded_edges" in found(Mesh(SPHERE.vertices * (1 + rough), SPHERE.faces))
    assert found(icosphere(1)) == {"few_vertices": 1}
    assert found((np.zeros((3, 3)), np.array([[0, 1, 2]])))["flat_meshes"] == 1
    with pytest.raises(InputError, match="Nothing of the mesh can be used"):
        repair((np.zeros((3, 3)), np.array([[0, 1, 2]])))


def test_faces_that_cut_through_each_other_are_told_where_libigl_is_there(monkeypatch):
    crossing = joined(SPHERE, Mesh(SPHERE.vertices + np.array([1, 0.1, 0.2]), SPHERE.faces))
    monkeypatch.setitem(sys.modules, "igl.copyleft", None)
    assert "self_intersections" not in found(crossing)
    monkeypatch.undo()
    pytest.importorskip("igl")
    assert found(crossing)["self_intersections"] > 50
    assert "self_intersections" not in found(SPHERE)
    assert "self_intersections" not in found(crossing, thorough=False)


def test_points_are_kept_once_and_finite():
    points = np.concatenate([SPHERE.vertices, SPHERE.vertices[:3], [[np.nan, 0, 0]]])
    repaired = repair((points, np.zeros((0, 3), int)))
    assert isinstance(repaired.shape, PointCloud)
    assert len(repaired.shape.vertices) == COUNT
    np.testing.assert_array_equal(repaired.vertex_index[COUNT:], [0, 1, 2, -1])
    np.testing.assert_array_equal(repaired.original_index, np.arange(COUNT))
    assert found(PointCloud(SPHERE.vertices)) == {}
    assert repaired.compacted() is repaired
    with pytest.raises(InputError, match="None of its points has three finite coordinates"):
        repair((np.full((3, 3), np.nan), np.zeros((0, 3), int)))


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


# different places that scaling rounds to one; non-manifold edges that remained
FAR_VERTICES = (
    np.array([[1.0, 1, 1], [0, 1, 1], *[[1.0, 1, 1]] * 3, [1e308, 1, 1], [1, 1, 1], [1, 1e308, 1]]),
    np.array([[0, 1, 7], [0, 5, 7], [2, 5, 7]]),
)
CROWDED_EDGES = (
    np.array(
        [[0.0, -1, 1], [1, 1, 1], [-1, -1, 1], [1, 1, 1], [-1, -1, 0], [1, 1, 1], [0.1, 1, 0]]
    ),
    np.array([[1, 6, 5], [2, 2, 1], [6, 3, 0], [3, 0, 5], [0, 0, 5], [1, 5, 2], [2, 3, 5]]),
)
# a face that is nothing once vertices within rounding are joined
WITHIN_ROUNDING = (
    np.array([[0.0, 1e-73, 1e-73], [1e-73, 1e-73, 1e-73], [1e-73, 1, 1e-73]]),
    np.array([[0, 2, 1]]),
)


@settings(max_examples=150, deadline=None)
@given(
    st.integers(1, 12).flatmap(
        lambda n: st.tuples(
            arrays(
                np.float64,
                (n, 3),
                elements=st.one_of(
                    st.sampled_from([0.0, 1.0, -1.0, np.nan, np.inf, 1e308, 5e-324]),
                    st.floats(-3, 3),
                ),
            ),
            arrays(
                np.int64,
                st.tuples(st.integers(0, 20), st.just(3)),
                elements=st.integers(-1, n),
            ),
        )
    )
)
@example(FAR_VERTICES)
@example(CROWDED_EDGES)
@example(WITHIN_ROUNDING)
def test_any_arrays_are_diagnosed_and_repaired_or_refused(mesh):
    vertices, _ = mesh
    diagnosis = diagnose(mesh)
    assert diagnosis.in_a_line()
    for everything in (False, True):
        try:
            repaired = repair(mesh, everything=everything)
        except InputError:
            continue
        index = repaired.vertex_index
        kept = index >= 0
        assert len(index) == len(vertices)
        here, there = vertices[repaired.original_index[index[kept]]], vertices[kept]
        # seams join within 5e-7 of the size, at most twelve vertices in a row
        rounding = 1e-5 * np.abs(vertices[np.isfinite(vertices).all(axis=1)]).max(initial=0)
        assert (np.abs(here / 2 - there / 2) <= rounding).all()
        if everything and isinstance(repaired.shape, Mesh):
            kinds = found(repaired.compacted().shape, thorough=False)
            assert not {"non_manifold_edges", "duplicate_faces", "loose_pieces"} & set(kinds)
