from dataclasses import replace

import numpy as np

from esd.mesh.mesh import Mesh
from esd.mesh.shapes import grid, icosphere
from esd.spectral.gradient import gradient_operator


def products(mesh: Mesh, f: np.ndarray, g: np.ndarray) -> np.ndarray:
    """⟨∇f, ∇g⟩ + i ⟨n, ∇f × ∇g⟩ at the vertices, whatever the tangent frames."""
    operator = gradient_operator(mesh)
    return (operator @ f).conj() * (operator @ g)


def test_gradients_of_linear_functions_on_a_plane_are_exact():
    mesh = grid(9, 7, width=2.0)
    x, y, _ = mesh.vertices.T
    np.testing.assert_allclose(products(mesh, x, x), 1, atol=1e-12)
    np.testing.assert_allclose(products(mesh, 3 * x + 4 * y, 3 * x + 4 * y), 25, atol=1e-11)
    # from x to y is a quarter turn to the left as seen from above, where the normals point
    np.testing.assert_allclose(products(mesh, x, y), 1j, atol=1e-12)
    np.testing.assert_allclose(gradient_operator(mesh) @ np.ones(len(x)), 0, atol=1e-12)


def test_seen_from_the_other_side_turns_go_the_other_way():
    mesh = grid(9, 7)
    x, y, _ = mesh.vertices.T
    below = replace(mesh, faces=mesh.faces[:, ::-1])
    np.testing.assert_allclose(products(below, x, y), -1j, atol=1e-12)


def test_gradients_on_a_sphere_converge_to_those_of_coordinates():
    errors = []
    for subdivisions in (3, 4):
        mesh = icosphere(subdivisions)
        x, y, z = mesh.vertices.T
        # with n the place itself, ∇x is e_x less its part along n, and ⟨n, e_x × e_y⟩ is z
        exact = -x * y + 1j * z
        errors.append(np.abs(products(mesh, x, y) - exact).max())
    assert errors[1] < 0.01
    assert np.log2(errors[0] / errors[1]) >= 1.5  # 2 but at the twelve vertices of five faces


def test_gradients_have_units_of_one_over_length_and_do_not_depend_on_the_pose(blob):
    x, y, _ = blob.vertices.T
    here = products(blob, x, y)
    turn = np.linalg.qr(np.random.default_rng(0).standard_normal((3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    moved = Mesh(5 * blob.vertices @ turn.T + 1, blob.faces)
    np.testing.assert_allclose(25 * products(moved, x, y), here, atol=1e-9)


def test_degenerate_faces_and_vertices_without_faces_have_no_gradient():
    flat = grid(9, 7)
    a, b, _ = flat.faces[20]
    vertices = np.concatenate([flat.vertices, flat.vertices[[[a], [b]]].mean(axis=0)])
    plain = Mesh(vertices, flat.faces)
    degenerate = Mesh(vertices, np.concatenate([flat.faces, [[a, b, len(vertices) - 1]]]))
    values = vertices[:, 0] ** 2
    values[-1] = 1e6  # which a face without a normal passes on to no other
    with_line, without = gradient_operator(degenerate) @ values, gradient_operator(plain) @ values
    assert with_line[-1] == without[-1] == 0
    np.testing.assert_allclose(with_line, without, atol=1e-12)
    assert np.abs(without).max() > 1
