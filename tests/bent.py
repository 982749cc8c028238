"""Small bent shapes with known points, of which stores and tables are made in a moment."""

from collections.abc import Iterable
from functools import partial

import numpy as np

from esd.datasets.collection import Collection, Shape
from esd.descriptors.recipe import Descriptor, Recipe
from esd.mesh.mesh import Mesh
from esd.mesh.shapes import torus

RECIPE = Recipe((Descriptor("hks", 6), Descriptor("wks", 5)), eigenpairs=15)


def bent(i: int) -> Mesh:
    mesh = torus(12, 8 + i)
    return Mesh(mesh.vertices + 0.1 * np.sin(mesh.vertices[:, [1, 2, 0]] * i), mesh.faces)


def points(i: int) -> np.ndarray:
    """The vertices of shape i at 60 points, of which it lacks one."""
    index = np.arange(60) + i
    index[7 + i] = -1
    return index


def bent_shapes(order: Iterable[int]) -> Collection:
    """Shapes c0, c1, …, in the given order; s2 is for testing."""
    shapes = (Shape(f"c{i}", f"s{i}", "t", partial(bent, i), partial(points, i)) for i in order)
    return Collection("bent", tuple(shapes), ("s2",))
