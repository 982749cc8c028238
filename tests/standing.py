"""A shape that stands."""

import numpy as np

from esd.mesh.mesh import Mesh
from esd.mesh.shapes import icosphere


def box(low, high) -> Mesh:
    """A closed box with triangles of about equal size."""
    sphere = icosphere(4)
    cube = sphere.vertices / np.abs(sphere.vertices).max(axis=1, keepdims=True)
    return Mesh((cube + 1) / 2 * np.subtract(high, low) + low, sphere.faces)


def joined(meshes) -> Mesh:
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    return Mesh(
        np.concatenate([mesh.vertices for mesh in meshes]),
        np.concatenate([mesh.faces + k for mesh, k in zip(meshes, starts[:-1], strict=True)]),
    )


def animal() -> Mesh:
    """A round body on four legs, longer than tall; up is y."""
    legs = [box((x, 0, z), (x + 0.1, 0.7, z + 0.1)) for x in (0.05, 0.25) for z in (0.1, 1.0)]
    body = icosphere(4)
    return joined([Mesh(body.vertices * [0.2, 0.2, 0.6] + [0.2, 0.8, 0.6], body.faces), *legs])
