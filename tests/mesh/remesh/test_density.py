import numpy as np

from esd.mesh.mesh import Mesh
from esd.mesh.remesh.density import DENSEST, density_and_metric
from esd.mesh.remesh.refinement import refined
from esd.mesh.remesh.styles import STYLES, Style
from esd.mesh.shapes import grid, icosphere


def test_even_triangles_take_lengths_as_they_are():
    mesh = icosphere(3)
    fine = refined(mesh, 1.0)
    density, metric = density_and_metric(mesh, fine, STYLES["even"])
    assert (density == 1).all()
    start, end = fine.edges.T
    length = np.linalg.norm(mesh.vertices[start] - mesh.vertices[end], axis=1)
    np.testing.assert_allclose(metric[start, end], length)
    np.testing.assert_allclose(metric[end, start], length)


def test_graded_triangles_are_denser_where_the_surface_bends():
    ball = icosphere(4)
    mesh = Mesh(ball.vertices * [1, 1, 4], ball.faces)  # sharpest at the two tips
    fine = refined(mesh, 9.0)
    density, _ = density_and_metric(mesh, fine, STYLES["adaptive"])
    height = np.abs(mesh.vertices[:, 2])
    assert density[height > 3.8].min() > 2 * density[height < 0.5].max()
    assert density.max() <= DENSEST
    assert density.min() >= 1 / DENSEST


def test_a_plane_bends_nowhere():
    mesh = grid(9, 9)
    density, _ = density_and_metric(mesh, refined(mesh, 9.0), STYLES["graded"])
    assert (density == 1).all()


def test_stretched_triangles_take_lengths_across_as_longer():
    ball = icosphere(4)
    mesh = Mesh(ball.vertices * [1, 1, 30], ball.faces)  # nearly a cylinder in the middle
    fine = refined(mesh, 99.0)
    _, metric = density_and_metric(mesh, fine, Style(stretch=3))
    start, end = fine.edges.T
    step = mesh.vertices[end] - mesh.vertices[start]
    middle = (np.abs(mesh.vertices[fine.edges][:, :, 2]) < 10).all(axis=1)
    around = middle & (np.abs(step[:, 2]) < 0.2 * np.linalg.norm(step, axis=1))
    ratio = np.asarray(metric[start, end]).ravel() / np.linalg.norm(step, axis=1)
    assert around.sum() > 10
    np.testing.assert_allclose(ratio[around], 3, rtol=0.05)
    along = middle & (np.abs(step[:, 2]) > 0.995 * np.linalg.norm(step, axis=1))
    assert ratio[along].max() < 1.1
