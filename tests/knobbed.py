"""Shapes of one class, each of its own connectivity, whose correspondences are known."""

import numpy as np

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
