import numpy as np

from esd.datasets.collection import Collection, Shape
from esd.datasets.remeshing import COARSEST, DENSEST, with_remeshings
from esd.mesh.mesh import Mesh
from esd.mesh.shapes import icosphere


def collection_of(mesh):
    index = np.arange(len(mesh.vertices))
    index[3] = -1
    return Collection("one", (Shape("a", "s", "t", lambda: mesh, lambda: index),))


def test_copies_have_other_triangles_and_keep_their_correspondence():
    mesh = icosphere(3)
    made = with_remeshings(collection_of(mesh), 2, seed=0)
    assert [shape.name for shape in made.shapes] == ["a", "a~0", "a~1"]
    assert {shape.subject for shape in made.shapes} == {"s"}
    for shape in made.shapes[1:]:
        copy, index = shape.mesh(), shape.correspondence()
        assert 0.9 * COARSEST < len(copy.vertices) < 1.1 * DENSEST
        assert index[3] == -1
        known = index >= 0
        gap = np.linalg.norm(copy.vertices[index[known]] - mesh.vertices[known], axis=1)
        assert gap.max() < 0.08  # the longest edge of 2,500 vertices on the unit sphere
        assert shape.symmetric is None
    assert len(made.shapes[1].mesh().vertices) != len(made.shapes[2].mesh().vertices)


def test_shapes_that_cannot_be_remeshed_are_copied_as_they_are(caplog):
    # a band with half a twist has no outside
    around, across = np.meshgrid(np.arange(40), np.linspace(-0.3, 0.3, 9), indexing="ij")
    angle = 2 * np.pi * around.ravel() / 40
    radius = 1 + across.ravel() * np.cos(angle / 2)
    height = across.ravel() * np.sin(angle / 2)
    vertices = np.stack([radius * np.cos(angle), radius * np.sin(angle), height], axis=1)
    row, column = (index.ravel() for index in np.meshgrid(np.arange(40), np.arange(8)))
    here, beside = 9 * row + column, 9 * row + column + 1
    # behind the last row comes the first, from its other end
    last = row == 39
    there = np.where(last, 8 - column, here + 9)
    across_there = np.where(last, 7 - column, beside + 9)
    faces = np.concatenate(
        [
            np.stack([here, there, beside], axis=1),
            np.stack([beside, there, across_there], axis=1),
        ]
    )
    band = Mesh(vertices, faces)
    made = with_remeshings(collection_of(band), 1, seed=0)
    assert len(made.shapes[1].mesh().faces) == len(band.faces)
    assert "keeps its triangles" in caplog.text
