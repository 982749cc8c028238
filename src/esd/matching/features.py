"""What matching takes of a shape: its spectrum, descriptors and embedding, computed once."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from esd.common import BoolArray, FloatArray, InputError, IntArray
from esd.descriptors.recipe import recipe_spectrum, spectrum_descriptors
from esd.learning.model import Model
from esd.mesh.mesh import Mesh, PointCloud
from esd.mesh.repair.repair import Repaired
from esd.mesh.surface import nearest_vertices
from esd.spectral.cache import Cache
from esd.spectral.coarse import MeshCopy, coarse_copy, copy_around, fine_copy
from esd.spectral.spectrum import Spectrum

_FEWEST = 2000  # vertices, of fewer than which descriptors differ between triangulations


@dataclass(frozen=True, slots=True, eq=False)
class Features:
    """A shape with its spectrum and embedding.

    Parameters
    ----------
    shape
        Repaired, or a copy of that.
    positions : (r, 3)
        Of its vertices before noise was smoothed, which thin bones do not survive.
    spectrum
        Of the shape.
    values : (r, w) float32
        Descriptors of its vertices, which the model embeds.
    embedded : (r, d)
        Embedding of its vertices.
    is_turned
        Whether the repair reoriented all of its faces outward.
    vertex_index, original_index : (n,) and (r,)
        The vertex of the shape of each of the n original ones, and back, see
        `esd.mesh.repair.repair.Repaired`. Where the shape is a coarse copy: of the repaired mesh.
        Vertices of loose pieces have their `stand_in`.
    filling
        How many of the last vertices of the repaired mesh fill holes.
    lost
        Share of the original vertices with a face that lie on loose pieces and have no stand-in.
    copy
        Where the vertices of the repaired mesh lie on the coarse copy, if the shape is one.
    """

    shape: Mesh | PointCloud
    positions: npt.NDArray[np.float64]
    spectrum: Spectrum
    values: npt.NDArray[np.float32]
    embedded: FloatArray
    is_turned: bool
    vertex_index: IntArray
    original_index: IntArray
    filling: int = 0
    lost: float = 0.0
    copy: MeshCopy | None = None

    def located(self, vertices: IntArray) -> IntArray:
        """The vertices of the shape, (l,), at some original ones; -1 for those left out."""
        repaired = self.vertex_index[vertices]
        if self.copy is None:
            return repaired
        nearest = nearest_vertices(self.copy.mesh, self.copy.points)
        return np.where(repaired >= 0, nearest[repaired], -1)

    def embedded_by(self, model: Model) -> Features:
        """The same with the embedding by another model of the same recipe."""
        operator = model.operator(self.shape, self.spectrum)
        return replace(self, embedded=model.embed(self.values, operator))

    def is_filling(self) -> BoolArray:
        """Whether each vertex of the repaired mesh fills a hole, (r,)."""
        count = len(self.original_index)
        return np.arange(count) >= count - self.filling


def reflected(features: Features, *, model: Model) -> Features:
    """Features of the mirror image of a mesh: the same spectrum, odd descriptors negated.

    Parameters
    ----------
    model
        That the features are by.

    Raises
    ------
    InputError
        If there are no faces, whose orientation a mirror image is of, or the model is
        convolutional or of parts.
    """
    if isinstance(features.shape, PointCloud) or not model.mirrors:
        raise InputError("Only meshes are mirrored, and not by models with convolutions or parts.")
    widths = [part.count for part in model.recipe.descriptors]
    is_odd = np.repeat([part.kind == "chirality" for part in model.recipe.descriptors], widths)
    values = np.where(is_odd, -features.values, features.values)
    # mirrored in x; faces are reversed, so that their normals still point outward
    mesh = Mesh(features.shape.vertices * [-1.0, 1.0, 1.0], features.shape.faces[:, ::-1])
    copy = features.copy
    if copy is not None:
        copy = replace(
            copy,
            mesh=mesh,
            vertices=copy.vertices * [-1.0, 1.0, 1.0],
            # of the corners in their new order
            points=replace(copy.points, weights=copy.points.weights[:, ::-1]),
        )
    return replace(
        features,
        shape=mesh,
        positions=features.positions * [-1.0, 1.0, 1.0],
        values=values,
        embedded=model.embed(values, model.operator(mesh, features.spectrum)),
        copy=copy,
    )


def shape_features(
    repaired: Repaired,
    *,
    model: Model,
    coarse: int | None = None,
    resample: bool = False,
    spectrum: Spectrum | None = None,
    cache: Cache | None = None,
) -> Features:
    """The spectrum, descriptors and embedding of a shape, or of its coarse copy.

    Parameters
    ----------
    coarse
        Number of vertices of the copy, see `esd.spectral.coarse.coarse_copy`. Of several pieces,
        the surface around them is the copy.
    resample
        Whether meshes too coarse for the descriptors, of fewer than two thousand vertices, are
        subdivided first, see `esd.spectral.coarse.fine_copy`.
    spectrum
        The `recipe_spectrum` of the repaired shape, where it is at hand and there is no copy.
    cache
        Where spectra and copies are looked up and kept.

    Raises
    ------
    InputError
        If the shape has no such copy, or cannot be described.
    """
    copy = None
    if repaired.around is not None:
        assert isinstance(repaired.shape, Mesh)
        copy = copy_around(repaired.shape, repaired.around)
    elif coarse is not None:
        copy = coarse_copy(repaired.shape, coarse, cache=cache)
    elif resample and isinstance(repaired.shape, Mesh) and len(repaired.shape.vertices) < _FEWEST:
        copy = fine_copy(repaired.shape, _FEWEST)
    shape = repaired.shape if copy is None else copy.mesh
    if spectrum is None or copy is not None:
        spectrum = recipe_spectrum(model.recipe, shape, cache=cache)
    values = spectrum_descriptors(model.recipe, shape, spectrum, single=True)
    return Features(
        shape,
        repaired.positions if copy is None else shape.vertices,
        spectrum,
        values,
        model.embed(values, model.operator(shape, spectrum, cache=cache)),
        repaired.is_flipped,
        np.where(repaired.vertex_index >= 0, repaired.vertex_index, repaired.stand_in),
        repaired.original_index,
        repaired.filling,
        repaired.lost,
        copy,
    )
