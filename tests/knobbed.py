"""Shapes of one class, each of its own connectivity, whose correspondences are known."""

from functools import partial

import numpy as np

from esd.datasets.collection import Shape
from esd.datasets.deformation import deformed
from esd.descriptors.recipe import Descriptor, Recipe, gradient_recipe
from esd.mesh.mesh import Mesh
from esd.mesh.shapes import icosphere

RECIPE = Recipe(
    (
        Descriptor("hks", 20, log=True),
        Descriptor("wks", 20, log=True),
        gradient_recipe("chirality", "hks", columns=range(0, 20, 4), reach=2, times=(4e-3, 1.6e-2)),
    ),
    eigenpairs=60,
)


def knobbed(seed: int) -> Mesh:
    """A ball with four knobs of different size and place, deformed; its vertices are shuffled."""
    ball = icosphere(3)
    knobs = np.array([[1, 0, 0], [0, 1, 0.2], [0.2, -0.5, 1], [-0.6, -0.6, -0.6]], dtype=float)
    knobs /= np.linalg.norm(knobs, axis=1, keepdims=True)
    closeness = np.exp(12 * (ball.vertices @ knobs.T - 1)) @ np.array([3.0, 2.0, 1.2, 2.5])
    limbs = Mesh(ball.vertices * (1 + closeness[:, None]), ball.faces)
    mesh = deformed(limbs, seed=seed, strain=0.1)
    order = order_of(seed)
    return Mesh(mesh.vertices[order], np.argsort(order)[mesh.faces])


def order_of(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).permutation(642)


def truth(source: int, target: int) -> np.ndarray:
    """The vertex of one knobbed ball for each vertex of another."""
    return np.argsort(order_of(target))[order_of(source)]


def knobbed_shape(seed: int, *, template: str | None = None) -> Shape:
    """A knobbed ball that knows its vertices; by a template's name, where they are of each."""
    everywhere = partial(np.arange, 642)
    if template is not None:
        everywhere = partial(np.argsort, order_of(seed))  # the vertex of each one of the ball
    name = f"s{seed}"
    return Shape(name, name, template or f"only {name}", partial(knobbed, seed), everywhere)
