"""A template registered to a scan: matched, deformed, and judged."""

from __future__ import annotations

import os
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree

from esd.common import BoolArray, InputError, IntArray
from esd.learning.model import Model
from esd.matching.correspondence import Correspondence
from esd.matching.match import DEFAULT_MODEL, match
from esd.mesh.convert import MeshLike
from esd.mesh.mesh import Mesh
from esd.mesh.repair.repair import repair, usable_part
from esd.registration.fit import Fit, fit
from esd.registration.quality import Quality, quality
from esd.spectral.cache import Cache


@dataclass(frozen=True, slots=True, eq=False)
class Registration:
    """A template's mesh on a scan.

    Parameters
    ----------
    mesh : Mesh
        The template's vertices, in their order, where they lie on the scan; its faces.
    supported : (n,)
        Whether the scan has a surface at a vertex; elsewhere the template was carried on smoothly.
    match : Correspondence
        The map from the template to the scan that was used.
    quality : Quality
        Figures.
    """

    mesh: Mesh
    supported: BoolArray
    match: Correspondence
    quality: Quality

    def __repr__(self) -> str:
        return (
            f"<Registration of {len(self.mesh.vertices)} vertices: "
            f"{self.quality.relative_distance:.2%} of the extent from the scan, "
            f"{self.quality.inverted} faces inverted>"
        )


def register(
    template: MeshLike,
    scan: MeshLike,
    *,
    correspondence: Correspondence | None = None,
    model: Model | str | os.PathLike[str] = DEFAULT_MODEL,
    landmarks: IntArray | None = None,
    cache: Cache | None = None,
) -> Registration:
    """The template's mesh deformed onto a scan.

    Parameters
    ----------
    template
        A mesh, or whatever `as_mesh` takes. Its vertices and faces are kept.
    scan
        The same, or a point cloud. Parts of it may be missing: the template is carried on smoothly
        there, as far as the map says so by confidence.
    correspondence
        From the template's vertices to those of the scan; by default computed by `esd.match`.
    model, landmarks, cache
        See `esd.match`; without effect if there is a correspondence.

    Raises
    ------
    InputError
        If the template has no faces, the map does not fit or has no match, or a shape cannot be
        used.
    """
    whole = usable_part(template)
    repaired = repair(template, all_pieces=True).compacted()
    assert isinstance(repaired.shape, Mesh)  # `usable_part` refuses points
    target = repair(scan, all_pieces=True)
    if correspondence is None:
        correspondence = match(
            template, scan, model=model, landmarks=landmarks, mirror="no", cache=cache
        )
    target_index = correspondence.target_index
    counts = len(repaired.vertex_index), len(target.vertex_index)
    if len(target_index) != counts[0]:
        raise InputError(f"The map has {len(target_index)} vertices; the template has {counts[0]}.")
    if target_index.max(initial=-1) >= counts[1]:
        raise InputError(
            f"The map names vertex {target_index.max()} (from 0); the scan has {counts[1]}."
        )
    index = target_index[repaired.original_index]
    index = np.where(index >= 0, target.vertex_index[index], -1)
    found = fit(
        repaired.shape, target.shape, index, correspondence.confidence[repaired.original_index]
    )
    return Registration(
        Mesh(_at_every_vertex(repaired.shape, found, whole, repaired.vertex_index), whole.faces),
        (repaired.vertex_index >= 0) & found.supported[repaired.vertex_index],
        correspondence,
        quality(repaired.shape, target.shape, found),
    )


def _at_every_vertex(
    used: Mesh, found: Fit, whole: Mesh, vertex_index: IntArray
) -> npt.NDArray[np.float64]:
    """Positions of all vertices, (n, 3); those without a face move with the nearest other one."""
    result: npt.NDArray[np.float64] = found.vertices[vertex_index]
    loose = np.flatnonzero(vertex_index < 0)
    if len(loose):
        near = KDTree(used.vertices).query(whole.vertices[loose])[1]
        offset = whole.vertices[loose] - used.vertices[near]
        result[loose] = found.vertices[near] + found.scale * offset
    return result
