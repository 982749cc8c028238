"""The spectrum with functions held at zero on the boundary."""

from __future__ import annotations

import numpy as np

from esd.common import InputError
from esd.mesh.geometry import is_referenced
from esd.mesh.mesh import Mesh
from esd.mesh.topology import boundary_edges
from esd.spectral.cache import Arrays, Cache, content_key
from esd.spectral.eigensolver import eigenpairs
from esd.spectral.laplacian import laplacian
from esd.spectral.spectrum import Spectrum

_VERSION = 1  # part of the cache's keys; raised when the eigenpairs may change


def dirichlet_spectrum(mesh: Mesh, k: int, *, cache: Cache | None = None) -> Spectrum:
    """The k smallest eigenpairs under Dirichlet boundary conditions, for unit surface area.

    Those of `esd.spectral.spectrum.spectrum` are under Neumann conditions: no heat leaves through
    the boundary, while here all that reaches it is lost. Near a boundary the two heat kernels
    differ from that of a surface which goes on by the same amount to first order, one above and
    one below (Kac 1966, *Can one hear the shape of a drum?*), so that their mean is close to it.

    Parameters
    ----------
    mesh
        Connected, with a boundary.
    k
        Number of eigenpairs; fewer where fewer vertices are inside.

    Raises
    ------
    InputError
        If the mesh has no boundary, or no vertex inside.
    """
    rim = np.unique(boundary_edges(mesh))
    inside = is_referenced(mesh)
    inside[rim] = False
    if len(rim) == 0 or not inside.any():
        raise InputError(
            "Dirichlet conditions need a boundary, and vertices that are not on it; this mesh has "
            f"{len(rim)} vertices on its boundary and {np.count_nonzero(inside)} inside."
        )

    def compute() -> Arrays:
        matrix, mass = laplacian(mesh)
        area = mass.sum()
        count = min(k, int(inside.sum()))
        solution = eigenpairs(matrix[inside][:, inside], mass[inside] / area, count)
        eigenvectors = np.zeros((len(mass), count))
        eigenvectors[inside] = solution.eigenvectors
        return {
            "eigenvalues": solution.eigenvalues,
            "eigenvectors": eigenvectors,
            "mass": mass / area,
        }

    key = content_key("dirichlet", mesh.vertices, mesh.faces, k=k, version=_VERSION)
    arrays = compute() if cache is None else cache.computed(key, compute)
    return Spectrum(**arrays, zero_modes=0)
