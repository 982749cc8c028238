"""Convolution over patches of a surface, at work without torch."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt
from scipy import sparse

from esd.common import FloatArray, InputError
from esd.learning.acnn import AnisotropicPatches, anisotropic_patches
from esd.learning.gcnn import GeodesicPatches, geodesic_patches
from esd.mesh.mesh import Mesh, PointCloud
from esd.mesh.topology import has_orientation, oriented_outward
from esd.spectral.cache import Arrays, Cache, content_key
from esd.spectral.laplacian import SparseMatrix

Patches: TypeAlias = GeodesicPatches | AnisotropicPatches

_VERSION = 1  # part of the cache's keys; raised when the operators may change
_CHUNK = 4096  # vertices


def patches_from_json(data: Mapping[str, Any]) -> Patches:
    """The patches of which `dataclasses.asdict` made plain data.

    Raises
    ------
    InputError
        If the data describe none.
    """
    kinds = {"geodesic": GeodesicPatches, "anisotropic": AnisotropicPatches}
    if not isinstance(data, Mapping):
        raise InputError(f"Patches must be an object of names and values; got {data!r}.")
    try:
        made: Patches = kinds[data["kind"]](**data)
    except (TypeError, KeyError) as error:
        raise InputError(f"These are no patches of a surface: {error}.") from error
    return made


def patch_operator(
    patches: Patches, shape: Mesh | PointCloud, *, cache: Cache | None = None
) -> SparseMatrix:
    """Weights (n · bins, n) float32 that average values at the vertices over the bins of patches.

    The bins of a vertex are adjacent. Rows sum to one.

    Parameters
    ----------
    cache
        Where the operator is looked up and kept.

    Raises
    ------
    InputError
        If the shape has no faces, or is inconsistently oriented, so that it has no outside.
    """
    if isinstance(shape, PointCloud):
        raise InputError(
            "Points have no faces, which patches need; take hks, wks or gps, or a model of these."
        )
    mesh = oriented_outward(shape)
    if not has_orientation(mesh):
        raise InputError(
            "The mesh is inconsistently oriented, so that its outside, and the direction around a "
            "vertex, are not defined. Repair it first (esd doctor MESH --repair OUT)."
        )

    def compute() -> Arrays:
        if isinstance(patches, GeodesicPatches):
            made = geodesic_patches(mesh, patches)
        else:
            made = anisotropic_patches(mesh, patches)
        indices, indptr = (each.astype(np.int32) for each in (made.indices, made.indptr))
        return {"data": made.data, "indices": indices, "indptr": indptr}

    key = content_key("patches", mesh.vertices, mesh.faces, version=_VERSION, **asdict(patches))
    arrays = compute() if cache is None else cache.computed(key, compute)
    size = len(mesh.vertices)
    rows = size * int(np.prod(patches.bins))
    parts = arrays["data"], arrays["indices"], arrays["indptr"]
    return sparse.csr_array(parts, shape=(rows, size))


def convolution(
    operator: SparseMatrix, values: FloatArray, weight: npt.NDArray[Any], *, turned: bool
) -> FloatArray:
    """Values (n, outputs) of filters over the patches of vertices.

    Parameters
    ----------
    operator
        Of `patch_operator`.
    values : (n, inputs)
        At the vertices.
    weight : (outputs, bins, bins, inputs)
        Of the filters: by ring and ray, or time and angle.
    turned
        Whether each filter is applied in all rotations by whole rays, and the largest result
        counts, since the first ray is arbitrary (angular max pooling, Masci et al. 2015).
    """
    outputs, rings, rays, _ = weight.shape
    turns = range(rays if turned else 1)
    # columns by turn, then output; rows by ring, ray and input, as the bins of a patch follow
    filters = np.stack([np.roll(weight, turn, axis=2) for turn in turns])
    filters = filters.reshape(len(turns) * outputs, -1).T
    bins = rings * rays
    result = np.empty((operator.shape[0] // bins, outputs))
    for start in range(0, len(result), _CHUNK):  # patches of all at once may be too much
        stop = min(start + _CHUNK, len(result))
        patched = (operator[start * bins : stop * bins] @ values).reshape(stop - start, -1)
        products = (patched @ filters).reshape(stop - start, len(turns), outputs)
        result[start:stop] = products.max(axis=1)
    return result
