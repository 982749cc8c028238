"""All that matching takes of a shape, computed once, and kept in a folder for other processes."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from esd.common import BoolArray, FloatArray, IntArray
from esd.descriptors.recipe import recipe_spectrum
from esd.learning.model import Model
from esd.mesh.mesh import Mesh, PointCloud
from esd.mesh.repair.repair import Repaired
from esd.spectral.cache import Cache
from esd.spectral.coarse import CoarseCopy, coarse_copy
from esd.spectral.spectrum import Spectrum


@dataclass(frozen=True, slots=True, eq=False)
class Described:
    """A shape with its spectrum and embedding.

    Parameters
    ----------
    shape
        Repaired, or a coarse copy of that.
    spectrum
        Of the shape.
    embedded : (r, d)
        Embedding of its vertices.
    is_turned
        Whether its faces were all turned outward by the repair.
    vertex_index, original_index : (n,) and (r,)
        The vertex of the shape of each of the n original ones, and back, see
        `esd.mesh.repair.repair.Repaired`. Where the shape is a coarse copy: of the repaired mesh.
    filling
        How many of the last vertices of the repaired mesh fill holes.
    copy
        Where the vertices of the repaired mesh lie on the coarse copy, if the shape is one.
    """

    shape: Mesh | PointCloud
    spectrum: Spectrum
    embedded: FloatArray
    is_turned: bool
    vertex_index: IntArray
    original_index: IntArray
    filling: int = 0
    copy: CoarseCopy | None = None

    def is_filling(self) -> BoolArray:
        """Whether each vertex of the repaired mesh fills a hole, (r,)."""
        count = len(self.original_index)
        return np.arange(count) >= count - self.filling


def describe(
    repaired: Repaired,
    *,
    model: Model,
    coarse: int | None = None,
    pairs: Spectrum | None = None,
    cache: Cache | None = None,
) -> Described:
    """The spectrum and the embedding of a shape, or of its coarse copy.

    Parameters
    ----------
    coarse
        Number of vertices of the copy, see `esd.spectral.coarse.coarse_copy`.
    pairs
        The `recipe_spectrum` of the repaired shape, where it is at hand and there is no copy.
    cache
        Where spectra and copies are looked up and kept.

    Raises
    ------
    InputError
        If the shape has no such copy, or cannot be described.
    """
    copy = None if coarse is None else coarse_copy(repaired.shape, coarse, cache=cache)
    shape = repaired.shape if copy is None else copy.mesh
    if pairs is None or copy is not None:
        pairs = recipe_spectrum(model.recipe, shape, cache=cache)
    return Described(
        shape,
        pairs,
        model.embed_spectrum(shape, pairs, cache=cache),
        # faces that were wound differently have no outside of their own that could be turned
        "inside_out_pieces" in repaired.done and "inconsistent_winding" not in repaired.done,
        repaired.vertex_index,
        repaired.original_index,
        repaired.filling,
        copy,
    )


def keep(described: Described, folder: Path) -> None:
    """Write to a new folder what `kept` reads."""
    pairs, copy = described.spectrum, described.copy
    arrays = {
        "vertices": described.shape.vertices,
        "eigenvalues": pairs.eigenvalues,
        "eigenvectors": pairs.eigenvectors,
        "mass": pairs.mass,
        "zero_modes": np.array(pairs.zero_modes),
        "embedded": described.embedded,
        "is_turned": np.array(described.is_turned),
        "vertex_index": described.vertex_index,
        "original_index": described.original_index,
        "filling": np.array(described.filling),
    }
    if isinstance(described.shape, Mesh):
        arrays["faces"] = described.shape.faces
    if copy is not None:
        arrays |= {
            "dense": copy.vertices,
            "face": copy.face,
            "barycentric": copy.barycentric,
        }
    folder.mkdir()
    for name, array in arrays.items():
        np.save(folder / f"{name}.npy", array, allow_pickle=False)


def kept(folder: Path) -> Described:
    """What `keep` wrote; arrays are mapped, so that processes share them."""
    arrays = {
        path.stem: np.load(path, mmap_mode="r", allow_pickle=False) for path in folder.glob("*.npy")
    }
    shape: Mesh | PointCloud = PointCloud(arrays["vertices"])
    if "faces" in arrays:
        shape = Mesh(arrays["vertices"], arrays["faces"])
    copy = None
    if isinstance(shape, Mesh) and "face" in arrays:
        copy = CoarseCopy(shape, arrays["dense"], arrays["face"], arrays["barycentric"])
    pairs = Spectrum(
        arrays["eigenvalues"], arrays["eigenvectors"], arrays["mass"], int(arrays["zero_modes"])
    )
    return Described(
        shape,
        pairs,
        arrays["embedded"],
        bool(arrays["is_turned"]),
        arrays["vertex_index"],
        arrays["original_index"],
        int(arrays["filling"]),
        copy,
    )
