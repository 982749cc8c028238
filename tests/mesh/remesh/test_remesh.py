import numpy as np
import pytest
from scipy.spatial import cKDTree

from esd.common import InputError
from esd.mesh.geometry import (
    components,
    edges,
    face_areas,
    face_normals,
    is_consistently_oriented,
    surface_area,
)
from esd.mesh.mesh import Mesh
from esd.mesh.remesh.remesh import remesh
from esd.mesh.remesh.styles import STYLES
from esd.mesh.shapes import grid, icosphere, torus
from esd.mesh.surface import positions
from esd.mesh.topology import boundary_edges
from measures import signed_volume


def euler_characteristic(mesh):
    return len(mesh.vertices) - len(edges(mesh)) + len(mesh.faces)


def faces_at_edges(mesh):
    sides = np.sort(mesh.faces[:, [[1, 2], [2, 0], [0, 1]]].reshape(-1, 2), axis=1)
    return np.unique(sides, axis=0, return_counts=True)[1]


def capsule():
    """A thin closed tube: with few vertices, cells go all the way around."""
    ball = icosphere(4)
    return Mesh(ball.vertices * [0.05, 0.05, 1.0], ball.faces)


@pytest.mark.parametrize("style", STYLES)
@pytest.mark.parametrize(
    ("mesh", "characteristic"),
    [(icosphere(3), 2), (torus(60, 24), 0), (capsule(), 2)],
    ids=["sphere", "torus", "capsule"],
)
def test_closed_surfaces_keep_their_topology_and_orientation(mesh, characteristic, style):
    new = remesh(mesh, 300, style=style, seed=4).mesh
    assert (faces_at_edges(new) == 2).all()
    assert euler_characteristic(new) == characteristic
    assert components(new).max() == 0
    assert is_consistently_oriented(new)
    # inscribed, so smaller; a capsule of 300 vertices has about 5 around
    assert 0.6 < signed_volume(new) / signed_volume(mesh) < 1.01
    assert face_areas(new).min() > 0


def test_vertices_are_added_where_cells_would_reach_around_the_surface():
    mesh = Mesh(icosphere(4).vertices * [0.02, 0.02, 1.0], icosphere(4).faces)
    new = remesh(mesh, 30, style="even", seed=0).mesh
    assert len(new.vertices) > 40
    assert (faces_at_edges(new) == 2).all()
    assert euler_characteristic(new) == 2


@pytest.mark.parametrize("style", STYLES)
def test_an_open_surface_keeps_its_one_border(style):
    mesh = grid(20, 20)
    new = remesh(mesh, 200, style=style, seed=0).mesh
    assert euler_characteristic(new) == 1
    assert len(np.unique(boundary_edges(new))) == len(boundary_edges(new))
    assert (faces_at_edges(new) <= 2).all()
    assert (face_normals(new)[:, 2] * face_normals(mesh)[0, 2] > 0).all()


def test_components_stay_apart():
    ball = icosphere(2)
    mesh = Mesh(
        np.vstack([ball.vertices, 0.05 * ball.vertices + [3, 0, 0]]),
        np.vstack([ball.faces, ball.faces + len(ball.vertices)]),
    )
    # the small ball has a four-hundredth of the area: no site falls on it by chance
    new = remesh(mesh, 60, seed=1).mesh
    assert components(new).max() == 1
    assert euler_characteristic(new) == 4


def test_new_vertices_lie_on_the_old_surface():
    mesh = torus(40, 20)
    result = remesh(mesh, 500, seed=2)
    # of the coordinates of a torus of radius 1.4, up to rounding
    assert np.abs(positions(mesh, result.points) - result.mesh.vertices).max() < 1e-12
    assert result.points.weights.min() >= 0
    assert np.allclose(result.points.weights.sum(axis=1), 1)


def test_nearest_is_the_nearest_vertex():
    mesh = icosphere(4)
    result = remesh(mesh, 400, seed=0)
    distance, _ = cKDTree(result.mesh.vertices).query(mesh.vertices)
    found = np.linalg.norm(result.mesh.vertices[result.nearest] - mesh.vertices, axis=1)
    assert np.allclose(found, distance)


def test_nearest_stays_on_its_side_of_a_thin_sheet():
    mesh = Mesh(icosphere(4).vertices * [1, 1, 1e-3], icosphere(4).faces)
    result = remesh(mesh, 800, style="even", seed=0)
    # near the rim, new triangles lead from one side to the other, how far depends on rounding
    a, b = result.mesh.vertices[edges(result.mesh)].transpose(1, 0, 2)
    across = a[:, 2] * b[:, 2] < 0
    rim = np.linalg.norm(np.concatenate([a[across], b[across]])[:, :2], axis=1).min()
    inner = np.linalg.norm(mesh.vertices[:, :2], axis=1) < rim
    assert inner.mean() > 0.2  # as on a sphere within 0.6 of the axis
    other = result.mesh.vertices[result.nearest, 2] * mesh.vertices[:, 2]
    assert (other[inner] > 0).all()


def test_old_vertices_without_a_face_have_no_nearest():
    ball = icosphere(2)
    mesh = Mesh(np.vstack([ball.vertices, [[5, 5, 5]]]), ball.faces)
    result = remesh(mesh, 50, seed=0)
    assert result.nearest[-1] == -1
    assert (result.nearest[:-1] >= 0).all()


def test_area_converges():
    mesh = icosphere(5)
    missing = [
        surface_area(mesh) - surface_area(remesh(mesh, n, style="even", seed=0).mesh)
        for n in (250, 1000)
    ]
    # inscribed triangles: the error falls with the square of the edge, that is, as 1 / n
    assert missing[0] / missing[1] == pytest.approx(4, rel=0.25)


def test_equal_seeds_give_equal_meshes_and_others_do_not():
    one, same, other = (remesh(icosphere(3), 200, seed=seed) for seed in (7, 7, 8))
    assert (one.mesh.vertices == same.mesh.vertices).all()
    assert (one.mesh.faces == same.mesh.faces).all()
    assert (one.nearest == same.nearest).all()
    assert one.mesh.vertices.shape != other.mesh.vertices.shape or (
        (one.mesh.vertices != other.mesh.vertices).any()
    )


def test_scaling_the_surface_scales_the_mesh():
    mesh = icosphere(3)
    one = remesh(mesh, 200, seed=0).mesh
    large = remesh(Mesh(1024 * mesh.vertices, mesh.faces), 200, seed=0).mesh
    # a power of two changes no digit
    assert (large.faces == one.faces).all()
    assert (large.vertices == 1024 * one.vertices).all()


def test_bad_input_is_named():
    mesh = icosphere(1)
    with pytest.raises(InputError, match="at least 4; got 3"):
        remesh(mesh, 3, seed=0)
    with pytest.raises(InputError, match=r"`style` must be one of graded, .*; got 'fancy'"):
        remesh(mesh, 20, style="fancy", seed=0)
    with pytest.raises(InputError, match="consistently oriented manifold"):
        remesh(Mesh(mesh.vertices, np.vstack([mesh.faces[:-1], mesh.faces[-1:, ::-1]])), 20, seed=0)
    bow = Mesh(
        np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0]]),
        np.array([[0, 1, 2], [0, 3, 4]]),
    )
    with pytest.raises(InputError, match="consistently oriented manifold"):
        remesh(bow, 20, seed=0)
    flat = Mesh(np.zeros((3, 3)), np.array([[0, 1, 2]]))
    with pytest.raises(InputError, match="no area"):
        remesh(flat, 20, seed=0)


def test_giving_up_says_what_to_do(monkeypatch):
    monkeypatch.setattr("esd.mesh.remesh.dual.REPAIRS", 0)
    with pytest.raises(InputError, match=r"about 20 vertices; ask for more"):
        remesh(icosphere(2), 20, seed=0)
