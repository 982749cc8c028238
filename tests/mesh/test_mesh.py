from types import SimpleNamespace

import numpy as np
import pytest

from esd.common import InputError
from esd.mesh import geometry as m
from esd.mesh.convert import as_mesh
from esd.mesh.mesh import Mesh
from esd.mesh.repair.repair import repair
from esd.mesh.shapes import grid, icosphere, subdivide, torus
from esd.mesh.topology import boundary_edges
from measures import signed_volume

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


def test_as_mesh_takes_what_holds_a_mesh():
    faces = np.array([[0, 1, 2]])
    trimesh = SimpleNamespace(vertices=TRIANGLE, faces=faces)
    meshio = SimpleNamespace(points=TRIANGLE, cells_dict={"triangle": faces})
    pyvista = SimpleNamespace(points=TRIANGLE, faces=np.array([3, 0, 1, 2]))
    for source in (Mesh(TRIANGLE, faces), (TRIANGLE, faces), trimesh, meshio, pyvista):
        np.testing.assert_array_equal(as_mesh(source).faces, faces)
    with pytest.raises(InputError, match="no triangles"):
        as_mesh(SimpleNamespace(points=TRIANGLE, cells_dict={"line": faces}))
    with pytest.raises(InputError, match="triangulate"):
        as_mesh(SimpleNamespace(points=TRIANGLE, faces=np.array([4, 0, 1, 2, 0])))
    with pytest.raises(InputError, match="Expected a mesh"):
        as_mesh(3)


def test_measures_of_known_shapes():
    flat = grid(4, 6, width=2, height=3)
    assert m.surface_area(flat) == pytest.approx(6)
    assert m.vertex_areas(flat).sum() == pytest.approx(6)
    np.testing.assert_allclose(m.vertex_normals(flat), np.tile([0, 0, 1.0], (24, 1)))
    assert len(boundary_edges(flat)) == 2 * (3 + 5)
    assert len(m.edges(icosphere(1))) == 3 * len(icosphere(1).vertices) - 6  # Euler
    assert m.is_consistently_oriented(torus(9, 7))
    assert not m.is_consistently_oriented(Mesh(TRIANGLE[[0, 1, 2, 2]], [[0, 1, 2], [0, 1, 3]]))


def test_volume_and_area_of_the_sphere_converge_at_order_two():
    errors = [
        (4 / 3 * np.pi - signed_volume(icosphere(s)), 4 * np.pi - m.surface_area(icosphere(s)))
        for s in (3, 4)
    ]
    order = np.log2(np.divide(*errors))
    assert (order > 1.9).all()


def test_components_come_largest_first_and_lone_vertices_have_none():
    big, small = icosphere(1), icosphere(0)
    count = len(small.vertices)
    mesh = Mesh(
        np.concatenate([small.vertices, big.vertices, [[9, 9, 9]]]),
        np.concatenate([small.faces, big.faces + count]),
    )
    label = m.components(mesh)
    np.testing.assert_array_equal(np.unique(label), [-1, 0, 1])
    assert (label[:count] == 1).all()
    assert label[-1] == -1


def test_subdivision_keeps_the_first_vertices():
    mesh = torus(6, 5)
    fine = subdivide(mesh)
    np.testing.assert_array_equal(fine.vertices[: len(mesh.vertices)], mesh.vertices)
    assert m.surface_area(fine) == pytest.approx(m.surface_area(mesh))
    assert signed_volume(fine) == pytest.approx(signed_volume(mesh))


def test_rows_of_different_lengths_are_refused_in_plain_words():
    triangle = [[0, 0, 0], [1, 0, 0], [0, 1, 0]]
    for make in (as_mesh, repair):
        for arrays, message in (
            (([[0, 0, 0], [1, 1]], [[0, 1, 2]]), "got words, or rows of different lengths"),
            ((triangle, [[0, 1, 2], [0, 1]]), "Cut polygons into triangles first"),
        ):
            with pytest.raises(InputError, match=message):
                make(arrays)
