"""From two shapes to a correspondence."""

from __future__ import annotations

import logging
import os

import numpy as np

from esd.common import FloatArray
from esd.descriptors.recipe import recipe_spectrum
from esd.learning.model import Model, load_model
from esd.matching.correspondence import Correspondence
from esd.matching.nearest import nearest
from esd.matching.refine import mean_squared_distance, zoomout
from esd.mesh.doctor import Repaired, repair
from esd.mesh.mesh import MeshLike
from esd.spectral.cache import Cache, default_cache
from esd.spectral.spectrum import Spectrum

_log = logging.getLogger(__name__)

DEFAULT_MODEL = "default"
"""Name of the model that is used where none is given."""


def match(
    source: MeshLike | Repaired,
    target: MeshLike | Repaired,
    *,
    model: Model | str | os.PathLike[str] = DEFAULT_MODEL,
    refine: bool | None = None,
    cache: Cache | None = None,
) -> Correspondence:
    """The target vertex that corresponds to each source vertex.

    Parameters
    ----------
    source, target
        Meshes, or whatever `as_mesh` takes, or points without faces. What is wrong with them is
        logged in one line, and what can be mended without harm is, see `esd.mesh.doctor`. The map
        is that of the original vertices; those left out have no match.
    model
        A `Model`, or what `load_model` takes.
    refine
        Whether the map is refined by `zoomout`; by default if the model tells left from right.
    cache
        Where spectra are looked up and kept; the user's cache by default.

    Raises
    ------
    InputError
        If a mesh or the model cannot be used.
    """
    model = model if isinstance(model, Model) else load_model(model)
    cache = default_cache() if cache is None else cache
    shapes = repair(source), repair(target)
    first, second = (recipe_spectrum(model.recipe, each.shape, cache=cache) for each in shapes)
    found = match_embedded(
        model.embed_spectrum(shapes[0].shape, first),
        model.embed_spectrum(shapes[1].shape, second),
        margin=model.margin,
        spectra=(first, second) if (model.is_oriented if refine is None else refine) else None,
    )
    for name, each in zip(("source", "target"), shapes, strict=True):
        if each.in_a_line():
            _log.warning("The %s has %s.", name, each.in_a_line())
    return for_original_vertices(found, *shapes)


def for_original_vertices(
    match: Correspondence, source: Repaired, target: Repaired
) -> Correspondence:
    """The map between the original vertices, of one between repaired shapes."""
    index = match.target_index[source.vertex_index]
    matched = (source.vertex_index >= 0) & (index >= 0)
    return Correspondence(
        np.where(matched, target.original_index[index], -1),
        np.where(matched, match.distance[source.vertex_index], np.inf),
        np.where(matched, match.confidence[source.vertex_index], 0.0),
    )


def match_embedded(
    source: FloatArray,
    target: FloatArray,
    *,
    margin: float | None,
    spectra: tuple[Spectrum, Spectrum] | None = None,
) -> Correspondence:
    """The nearest row of `target` (m, d) to each row of `source` (n, d) as a correspondence.

    Parameters
    ----------
    margin
        C of the similarity exp(−distance² / C) (section 3.4 of the paper leaves its form open).
        Where there is none, it is the mean squared distance of any two rows, so that descriptors
        no more alike than chance have similarity exp(−1).
    spectra
        Of the source and the target; the map is then refined by `zoomout`, and the distances are
        those of the refined matches.
    """
    index, distance = nearest(source, target)
    if spectra is not None:
        index = zoomout(*spectra, index, embeddings=(source, target))
        reached = np.linalg.norm(source - target[index], axis=1)
        distance = np.where(index >= 0, reached, np.inf)
    scale = mean_squared_distance(source, target) if margin is None else margin
    return Correspondence(index, distance, np.exp(-(distance**2) / scale))
