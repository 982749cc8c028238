"""Smoothly deformed copies of meshes: other builds of the same shape, whose truth is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from esd.common import InputError
from esd.mesh.mesh import Mesh

_WAVES = 4
_WAVELENGTHS = 0.5, 2.0  # shortest and longest, in sizes of the shape


def deformed(mesh: Mesh, *, seed: int, strain: float = 0.35) -> Mesh:
    """A mesh with the same faces, bent, thickened and stretched smoothly in space.

    Each of a few plane waves x → x + a sin(⟨w, x⟩ + p) d, one after the other, has random
    directions w and d and a wavelength of half to two sizes of the shape; then space is stretched
    along three random axes. Each wave has a Jacobian of positive determinant, 1 + a ⟨w, d⟩ cos(…),
    so no volume is turned inside out.

    Parameters
    ----------
    seed
        Of all that is random.
    strain
        Largest a |w|, and largest logarithm of the scale along an axis, from 0 to less than 1.

    Raises
    ------
    InputError
        If the strain is not between 0 and 1.
    """
    if not 0 <= strain < 1:
        raise InputError(f"`strain` must be from 0 to less than 1; got {strain}.")
    generator = np.random.default_rng(seed)
    size = np.ptp(mesh.vertices, axis=0).max()
    points = mesh.vertices - mesh.vertices.mean(axis=0)
    for _ in range(_WAVES):
        wave, direction = _unit(generator), _unit(generator)
        wave *= 2 * np.pi / (size * generator.uniform(*_WAVELENGTHS))
        amplitude = strain * generator.uniform(0.5, 1) / np.linalg.norm(wave)
        phase = points @ wave + generator.uniform(0, 2 * np.pi)
        points = points + amplitude * np.sin(phase)[:, None] * direction
    axes, _ = np.linalg.qr(generator.normal(size=(3, 3)))
    scale = np.exp(generator.uniform(-strain, strain, size=3))
    return replace(mesh, vertices=(points @ axes * scale) @ axes.T)


def _unit(generator: np.random.Generator) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """A random direction, (3,)."""
    direction = generator.normal(size=3)
    return np.asarray(direction / np.linalg.norm(direction))
