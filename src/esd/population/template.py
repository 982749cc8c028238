"""The template of a population, where none is given: the shape nearest to the middle."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from esd.common import FloatArray
from esd.datasets.collection import Shape
from esd.mesh.mesh import Mesh
from esd.mesh.repair.repair import repair
from esd.spectral.cache import Cache
from esd.spectral.coarse import coarse_copy
from esd.spectral.spectrum import spectrum

_EIGENVALUES = 50


def shape_dna(shape: Shape, *, cache: Cache | None = None) -> npt.NDArray[np.float64]:
    """The first eigenvalues of a shape of unit area over those of Weyl's law, (50,).

    References
    ----------
    Reuter, Wolter, Peinecke 2006, *Laplace-Beltrami spectra as 'Shape-DNA'* (sections 2.3 and 3.1).
    """
    mesh = repair(shape.mesh(), restore=True).compacted().shape
    assert isinstance(mesh, Mesh)  # `Shape.mesh` reads one
    # the first is zero; by Weyl's law the i-th is about 4 π i for unit area, which `spectrum` has
    values = spectrum(mesh, _EIGENVALUES + 1, cache=cache).eigenvalues[1:]
    return np.asarray(values / (4 * np.pi * np.arange(1, len(values) + 1)))


def medoid(rows: Sequence[FloatArray]) -> int:
    """The row with the least sum of distances to all others."""
    table = np.stack(rows)
    return int(np.linalg.norm(table[:, None] - table, axis=2).sum(axis=1).argmin())


def as_template(mesh: Mesh, *, vertex_count: int, cache: Cache | None = None) -> Mesh:
    """A shape as a template: repaired, its largest piece, remeshed if it has more vertices.

    Raises
    ------
    InputError
        If nothing of it can be used.
    """
    repaired = repair(mesh, restore=True).compacted().shape
    if len(repaired.vertices) <= vertex_count:
        assert isinstance(repaired, Mesh)
        return repaired
    manifold = repair(mesh, everything=True).compacted().shape
    return coarse_copy(manifold, vertex_count, cache=cache).mesh
