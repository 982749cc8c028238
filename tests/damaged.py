"""Meshes with defects, and what is found in them."""

import numpy as np

from esd.mesh.mesh import Mesh
from esd.mesh.repair.diagnose import diagnose
from esd.mesh.shapes import icosphere

SPHERE = icosphere(3)
COUNT = len(SPHERE.vertices)


def found(source, **options) -> dict[str, int]:
    """Kinds of findings, and how many there are of each."""
    return {finding.kind: finding.count for finding in diagnose(source, **options).findings}


def soup(mesh: Mesh) -> tuple[np.ndarray, np.ndarray]:
    """Each face with corners of its own, as in an STL file."""
    return mesh.vertices[mesh.faces].reshape(-1, 3), np.arange(mesh.faces.size).reshape(-1, 3)


def joined(*meshes: Mesh) -> tuple[np.ndarray, np.ndarray]:
    """The meshes as one, unconnected."""
    start = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    return (
        np.concatenate([mesh.vertices for mesh in meshes]),
        np.concatenate([mesh.faces + s for mesh, s in zip(meshes, start, strict=False)]),
    )


def touching_spheres() -> Mesh:
    """Two spheres that share one vertex: the highest of the one is the lowest of the other."""
    other = SPHERE.vertices * [1, 1, -1] + [0, 0, 2 * SPHERE.vertices[:, 2].max()]
    top = int(SPHERE.vertices[:, 2].argmax())
    faces = SPHERE.faces[:, ::-1] + COUNT
    faces[faces == top + COUNT] = top
    return Mesh(np.concatenate([SPHERE.vertices, other]), np.concatenate([SPHERE.faces, faces]))
