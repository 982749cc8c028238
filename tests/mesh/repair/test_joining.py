import numpy as np
import pytest

from damaged import COUNT, SPHERE, found, soup, touching_spheres
from esd.common import InputError
from esd.mesh.geometry import (
    components,
    is_referenced,
)
from esd.mesh.mesh import Mesh
from esd.mesh.repair.diagnose import diagnose
from esd.mesh.repair.repair import repair
from esd.mesh.shapes import grid
from esd.mesh.topology import boundary_edges
from esd.spectral.spectrum import spectrum


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
