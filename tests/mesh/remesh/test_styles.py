import numpy as np

from esd.mesh.geometry import (
    edge_lengths,
    edges,
    face_areas,
)
from esd.mesh.mesh import Mesh
from esd.mesh.remesh.remesh import remesh
from esd.mesh.remesh.styles import Style
from esd.mesh.shapes import icosphere


def test_even_triangles_are_nearly_equilateral():
    new = remesh(icosphere(4), 1000, style="even", seed=0).mesh
    length = edge_lengths(new)
    # optimal centroidal tessellations have about 0.05; a random sample 0.4
    assert length.std() / length.mean() < 0.2
    quality = 4 * np.sqrt(3) * face_areas(new) / (length**2).sum(axis=1)
    assert quality.mean() > 0.9


def test_graded_triangles_are_smaller_where_the_surface_bends():
    mesh = Mesh(icosphere(4).vertices * [1, 1, 4], icosphere(4).faces)

    def tip_over_middle(style):
        new = remesh(mesh, 1000, style=style, seed=0).mesh
        height = np.abs(new.vertices[new.faces].mean(axis=1)[:, 2])
        areas = face_areas(new)
        return areas[height > 3.5].mean() / areas[height < 1].mean()

    assert tip_over_middle("graded") < 0.6 * tip_over_middle("even")


def test_stretched_triangles_are_longer_along_a_cylinder():
    ball = icosphere(4)
    mesh = Mesh(ball.vertices * [1, 1, 8], ball.faces)
    new = remesh(mesh, 1500, style=Style(stretch=3, relaxing=0), seed=0).mesh
    sides = np.diff(new.vertices[edges(new)], axis=1)[:, 0]
    along, around = np.abs(sides[:, 2]), np.linalg.norm(sides[:, :2], axis=1)
    assert along.mean() > 1.5 * around.mean()
