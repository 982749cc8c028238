import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from damaged import SPHERE, joined, touching_spheres
from esd.common import InputError
from esd.mesh.geometry import edges, is_consistently_oriented, surface_area
from esd.mesh.mesh import Mesh
from esd.mesh.shapes import grid, icosphere, torus
from esd.mesh.topology import (
    boundary_edges,
    compacted,
    edge_table,
    fan_count,
    has_orientation,
    largest_piece,
    oriented_outward,
    patches,
    rims,
    with_flipped,
    without_repeats,
)
from measures import signed_volume

FIN = np.array([[0, 1, 2], [1, 0, 3], [0, 1, 4]])  # three faces at the edge 0-1


def table_of(mesh: Mesh):
    return edge_table(mesh.faces, len(mesh.vertices))


def test_an_edge_table_of_three_faces_at_one_edge():
    table = edge_table(FIN, 5)
    np.testing.assert_array_equal(table.ends[0], [0, 1])
    assert table.count.tolist() == [3, 1, 1, 1, 1, 1, 1]
    np.testing.assert_array_equal(table.of_side[:, 2], [0, 0, 0])  # opposite to the third corners
    assert len(table.inner_sides()) == 0
    assert len(table.open_sides()) == 6
    linked = table.adjacent_sides()
    assert linked.tolist() == [[2, 5], [5, 8]]
    np.testing.assert_array_equal(table.are_alike(linked), [False, False])
    assert table.are_alike(np.array([[2, 8]])).all()


@given(
    st.lists(
        st.lists(st.integers(0, 6), min_size=3, max_size=3, unique=True), min_size=1, max_size=12
    )
)
def test_an_edge_table_lists_every_side_once_at_its_edge(faces):
    faces = np.array(faces)
    table = edge_table(faces, 7)
    assert sorted(table.by_edge) == list(range(3 * len(faces)))
    assert table.count.sum() == 3 * len(faces)
    ends = np.sort(np.stack([table.start, table.end], axis=1), axis=1)
    np.testing.assert_array_equal(table.ends[table.of_side.ravel()], ends)
    for face, corner in np.ndindex(*faces.shape):  # no side has its opposite corner
        assert faces[face, corner] not in ends[3 * face + corner]
    assert len(table.adjacent_sides()) == (table.count - 1).sum()
    for pairs in (table.adjacent_sides(), table.inner_sides()):
        edge = table.of_side.ravel()[pairs]
        np.testing.assert_array_equal(edge[:, 0], edge[:, 1])


def test_the_edges_of_a_table_are_those_of_the_mesh():
    mesh = torus(9, 5)
    np.testing.assert_array_equal(table_of(mesh).ends, edges(mesh))
    assert (table_of(mesh).count == 2).all()


def test_no_faces_have_no_edges():
    table = edge_table(np.zeros((0, 3), dtype=np.int64), 0)
    assert table.ends.shape == (0, 2)
    assert table.adjacent_sides().shape == table.inner_sides().shape == (0, 2)


def test_boundary_edges_run_as_in_their_face():
    flat = grid(4, 3)
    rim = boundary_edges(flat)
    assert len(rim) == 2 * (3 + 2)
    directed = {
        (a, b) for face in flat.faces.tolist() for a, b in zip(face, np.roll(face, -1), strict=True)
    }
    assert {tuple(edge) for edge in rim.tolist()} <= directed
    found, length = rims(flat, table_of(flat))
    np.testing.assert_array_equal(found[:, :2], rim)
    np.testing.assert_allclose(length, [4])
    assert rims(SPHERE, table_of(SPHERE))[0].shape == (0, 3)


def test_a_vertex_that_parts_share_has_two_fans():
    mesh = touching_spheres()
    fans = fan_count(mesh.faces, table_of(mesh), len(mesh.vertices))
    assert (fans == 2).sum() == 1
    sphere = fan_count(SPHERE.faces, table_of(SPHERE), len(SPHERE.vertices) + 1)
    assert (sphere[:-1] == 1).all()
    assert sphere[-1] == 0
    assert fan_count(FIN, edge_table(FIN, 5), 5).max() == 1  # joined over the edge of three


def test_a_minority_of_faces_is_flipped():
    flipped = np.random.default_rng(0).random(len(SPHERE.faces)) < 0.3
    mesh = with_flipped(SPHERE, flipped)
    assert not has_orientation(mesh)
    assert not is_consistently_oriented(mesh)
    found, patch, non_orientable = patches(mesh.faces, table_of(mesh))
    np.testing.assert_array_equal(found, flipped)
    assert set(patch) == {0}
    assert not non_orientable.any()
    assert has_orientation(with_flipped(mesh, found))


def test_closed_pieces_are_oriented_outward():
    inward = Mesh(SPHERE.vertices, SPHERE.faces[:, ::-1])
    assert signed_volume(inward) < 0
    np.testing.assert_array_equal(oriented_outward(inward).faces, inward.faces[:, ::-1])
    np.testing.assert_array_equal(oriented_outward(SPHERE).faces, SPHERE.faces)


def test_the_piece_of_the_largest_area_is_kept_without_other_vertices():
    small = Mesh(icosphere(3).vertices / 2, icosphere(3).faces)
    two = Mesh(*joined(small, icosphere(1)))
    largest = largest_piece(two)
    assert surface_area(largest) == pytest.approx(surface_area(icosphere(1)))
    compact, index = compacted(largest)
    assert len(compact.vertices) == 42
    np.testing.assert_array_equal(index[-42:], np.arange(42))
    assert (index[:-42] == -1).all()


def test_repeated_and_collapsed_faces_are_left_out():
    faces = [[0, 1, 2], [1, 2, 0], [0, 0, 1]]
    assert without_repeats(Mesh(np.eye(3), faces)).faces.tolist() == [[0, 1, 2]]
    with pytest.raises(InputError, match="all its faces are degenerate"):
        without_repeats(Mesh(np.eye(3), faces[2:]))
