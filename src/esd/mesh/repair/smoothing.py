"""Noise taken out of the positions of vertices."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from esd.mesh.geometry import adjacency, edges
from esd.mesh.mesh import Mesh

_ROUNDS = 10
_FORTH, _BACK = 0.5, 0.53  # the second a little larger, so that the shape does not shrink


def smoothed(mesh: Mesh) -> Mesh:
    """The mesh with vertices moved to and fro between their neighbours, so that noise cancels out.

    Taubin 1995, *A signal processing approach to fair surface design*: λ of 0.5, μ of −0.53, ten
    rounds, the mean of a vertex's neighbours for the Laplacian.
    """
    neighbours = adjacency(edges(mesh), len(mesh.vertices))
    degree = neighbours.sum(axis=1)[:, None]
    vertices = mesh.vertices
    for _ in range(_ROUNDS):
        for step in (_FORTH, -_BACK):
            gap = neighbours @ vertices - degree * vertices
            vertices = vertices + step * gap / np.maximum(degree, 1)
    return replace(mesh, vertices=vertices)
