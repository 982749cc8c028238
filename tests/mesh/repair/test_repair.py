import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from damaged import COUNT, SPHERE, found, joined
from esd.common import InputError
from esd.mesh.geometry import (
    components,
    is_consistently_oriented,
)
from esd.mesh.mesh import Mesh, PointCloud
from esd.mesh.repair.diagnose import diagnose
from esd.mesh.repair.repair import repair
from esd.mesh.shapes import grid, icosphere, torus
from esd.mesh.topology import boundary_edges, edge_table
from measures import signed_volume


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


def test_faces_without_vertices_are_refused_unless_all_is_to_be_repaired():
    broken = (SPHERE.vertices, np.concatenate([SPHERE.faces, [[0, 1, COUNT], [0, -1, 2]]]))
    assert found(broken)["missing_vertices"] == 2
    with pytest.raises(InputError, match="must hold indices"):
        repair(broken)
    np.testing.assert_array_equal(repair(broken, everything=True).shape.faces, SPHERE.faces)


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


def test_pieces_that_touch_are_kept_together_where_the_largest_leaves_out_much():
    half = SPHERE.vertices[SPHERE.faces, 2].mean(axis=1) > 0
    parts = [Mesh(SPHERE.vertices, SPHERE.faces[half])]
    parts.append(Mesh(SPHERE.vertices - [0, 0, 0.02], SPHERE.faces[~half]))
    parts.append(Mesh(SPHERE.vertices / 10 + 5, SPHERE.faces))
    pieces = joined(*parts)
    assert repair(pieces).around is None
    together = repair(pieces, together=True)
    assert len(boundary_edges(together.around)) == 0
    assert "2 loose pieces (those that touch are matched together)" in together.in_a_line()
    assert "holes" not in together.not_repaired()
    ball = np.arange(3 * COUNT) >= 2 * COUNT
    assert not (together.vertex_index[ball] >= 0).any()
    assert together.lost == pytest.approx(
        COUNT / np.count_nonzero(np.isin(np.arange(3 * COUNT), pieces[1]))
    )
    # the other piece is far away: there is nothing to be joined
    assert repair(joined(SPHERE, icosphere(1)), together=True).around is None


def test_a_ground_plane_is_left_out_and_counts_as_nothing():
    x, y = np.meshgrid(np.linspace(-2, 2, 5), np.linspace(-2, 2, 5))
    square = np.stack([x.ravel(), y.ravel(), np.full(25, -1.0)], axis=1)
    corner = np.add.outer(5 * np.arange(4), np.arange(4)).ravel()[:, None]
    ground = np.concatenate([corner + np.array([0, 1, 6]), corner + np.array([0, 6, 5])])
    vertices = np.concatenate([SPHERE.vertices, square])
    faces = np.concatenate([SPHERE.faces, ground + COUNT])
    repaired = repair((vertices, faces))
    assert "1 flat piece that everything else lies on (left out)" in repaired.in_a_line()
    np.testing.assert_array_equal(repaired.vertex_index >= 0, np.arange(COUNT + 25) < COUNT)
    assert repaired.lost == 0
    assert (repair((vertices, faces), all_pieces=True).vertex_index >= 0).all()


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


def test_dense_meshes_are_repaired_entirely_but_for_damaged_faces():
    # two spheres that share an edge: cut apart only where everything is repaired
    start, end = SPHERE.faces[0, :2]
    other = SPHERE.faces + COUNT
    other[SPHERE.faces == start], other[SPHERE.faces == end] = start, end
    moved = SPHERE.vertices + np.array([3.0, 0.0, 0.0])
    mesh = Mesh(np.concatenate([SPHERE.vertices, moved]), np.concatenate([SPHERE.faces, other]))
    assert edge_table(repair(mesh).shape.faces, 2 * COUNT).count.max() == 4
    for dense in (0, 100):
        found_mesh = repair(mesh, dense=dense).shape
        assert edge_table(found_mesh.faces, len(found_mesh.vertices)).count.max() == 2
    with pytest.raises(InputError, match="must hold indices"):
        repair((mesh.vertices, np.append(mesh.faces, [[0, 1, 9999]], axis=0)), dense=0)


def test_a_file_that_is_refused_is_named(tmp_path):
    path = tmp_path / "bad.off"
    path.write_text("OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 7\n")
    with pytest.raises(InputError, match=r"bad.off': `faces` must hold indices from 0 to 2"):
        repair(path)


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


def test_a_repaired_shape_is_shown_in_one_line():
    vertices = np.concatenate([SPHERE.vertices, [[9.0, 9.0, 9.0]]])
    shown = repr(repair((vertices, SPHERE.faces)))
    assert shown == (
        f"<Repaired Mesh of {len(vertices)} vertices and {len(SPHERE.faces)} faces "
        f"of {len(vertices)} vertices>"
    )
