"""A template registered to a scan: matched, deformed, and judged."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree

from esd.common import BoolArray, InputError, IntArray
from esd.deformation.fit import Fit, fit
from esd.learning.model import Model
from esd.matching.correspondence import Correspondence
from esd.matching.match import DEFAULT_MODEL, match
from esd.mesh.convert import MeshLike
from esd.mesh.mesh import Mesh
from esd.mesh.repair.repair import Repaired, repair, usable_part
from esd.registration.quality import Quality, quality
from esd.spectral.cache import Cache

_FARTHER, _CLOSE = 2.0, 0.002  # times the distance before, and of the extent: beyond both is lost
_LESS = 0.05  # of the vertices, by which a frame may have less support


@dataclass(frozen=True, slots=True, eq=False)
class Registration:
    """A template's mesh on a scan.

    Parameters
    ----------
    mesh : Mesh
        The template's vertices, in their order, where they lie on the scan; its faces.
    supported : (n,)
        Whether the scan has a surface at a vertex; elsewhere the template was carried on smoothly.
    match : Correspondence or None
        The map from the template to the scan that was used; None where it started from the frame
        before.
    quality : Quality
        Figures.
    scale : float
        Lengths of the scan over those of the template.
    """

    mesh: Mesh
    supported: BoolArray
    match: Correspondence | None
    quality: Quality
    scale: float

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
    source, target = _template(template), repair(scan, all_pieces=True)
    if correspondence is None:
        correspondence = match(
            template, scan, model=model, landmarks=landmarks, mirror="no", cache=cache
        )
    target_index = correspondence.target_index
    counts = len(source.repaired.vertex_index), len(target.vertex_index)
    if len(target_index) != counts[0]:
        raise InputError(f"The map has {len(target_index)} vertices; the template has {counts[0]}.")
    if target_index.max(initial=-1) >= counts[1]:
        raise InputError(
            f"The map names vertex {target_index.max()} (from 0); the scan has {counts[1]}."
        )
    original = source.repaired.original_index
    index = target_index[original]
    index = np.where(index >= 0, target.vertex_index[index], -1)
    found = fit(source.mesh, target.shape, index, correspondence.confidence[original])
    return _result(source, target, found, correspondence)


def register_sequence(
    template: MeshLike,
    scans: Iterable[MeshLike],
    *,
    correspondence: Correspondence | None = None,
    model: Model | str | os.PathLike[str] = DEFAULT_MODEL,
    landmarks: IntArray | None = None,
    cache: Cache | None = None,
) -> Iterator[Registration]:
    """The template deformed onto each scan of a sequence, each frame started from the last.

    The first frame is registered along a map, as by `register`; the others start from the frame
    before and follow the nearest points of the surface, without a map. A frame in which the
    template loses the surface is registered along a map of its own, if that is better.

    Parameters
    ----------
    template
        A mesh, or whatever `as_mesh` takes.
    scans
        The same, or point clouds, in the order of time; read one at a time if they are paths.
    correspondence
        From the template to the first scan.
    model, cache
        See `register`.
    landmarks
        Of the template and the first scan.

    Raises
    ------
    InputError
        As `register` does.
    """
    source = _template(template)
    last: Registration | None = None
    by_map: Quality | None = None  # of the last frame that was registered along a map
    for scan in scans:
        if last is None or by_map is None:
            last = register(
                template,
                scan,
                correspondence=correspondence,
                model=model,
                landmarks=landmarks,
                cache=cache,
            )
            by_map = last.quality
        else:
            last = _started(source, scan, last)
            if _is_lost(last.quality, by_map):
                anew = register(template, scan, model=model, cache=cache)
                if anew.quality.supported > last.quality.supported:
                    last, by_map = anew, anew.quality
        yield last


def _started(source: _Template, scan: MeshLike, last: Registration) -> Registration:
    """The template on a scan, from where it was on the last one."""
    target = repair(scan, all_pieces=True)
    original = source.repaired.original_index
    none = np.full(len(original), -1)
    found = fit(
        source.mesh,
        target.shape,
        none,
        np.zeros(len(none)),
        start=last.mesh.vertices[original],
        scale=last.scale,
    )
    return _result(source, target, found, None)


def _is_lost(found: Quality, before: Quality) -> bool:
    """Whether a frame has much less of the surface than one before, or is much farther from it."""
    is_far = found.relative_distance > max(_FARTHER * before.relative_distance, _CLOSE)
    return is_far or not found.supported > before.supported - _LESS


@dataclass(frozen=True, slots=True, eq=False)
class _Template:
    """The template with all its vertices, and as it is deformed: those with a face."""

    whole: Mesh
    repaired: Repaired
    mesh: Mesh


def _template(template: MeshLike) -> _Template:
    whole = usable_part(template)
    repaired = repair(template, all_pieces=True).compacted()
    assert isinstance(repaired.shape, Mesh)  # `usable_part` refuses points
    return _Template(whole, repaired, repaired.shape)


def _result(
    source: _Template, target: Repaired, found: Fit, correspondence: Correspondence | None
) -> Registration:
    vertex_index = source.repaired.vertex_index
    return Registration(
        Mesh(_at_every_vertex(source.mesh, found, source.whole, vertex_index), source.whole.faces),
        (vertex_index >= 0) & found.supported[vertex_index],
        correspondence,
        quality(source.mesh, target.shape, found),
        found.scale,
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
