"""Whether shapes are parts of a whole, at which scale, and the map between them then."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal, TypeAlias

import numpy as np

from esd.common import IntArray
from esd.learning.model import Model, load_model
from esd.matching.features import Features
from esd.matching.part_registration import best_registered
from esd.matching.partial import Part, PartMap, part, part_map, refined_part_map
from esd.mesh.geometry import components, surface_area
from esd.mesh.mesh import Mesh
from esd.mesh.topology import boundary_edges
from esd.spectral.cache import Cache

BUNDLED = "partial"
"""Name of the model of parts that is used beside models of whole shapes."""

Scale: TypeAlias = Literal["auto", "same", "free"]
"""Whether shapes have one unit of length: taken to be so unless it fits badly, so, or not so.

`auto` takes it to be so in any case where both are parts.
"""

MISFITS = 0.6
"""Consistent share below which a map between parts is not taken to be one."""

_OPEN = 0.15  # length of all boundaries, in √area, beyond which something may be missing
_OTHER_UNITS = 0.25  # consistent share below which `auto` gives up that units are the same
_LARGER = (1.0, 1.25, 1.6, 2.0)  # area of the whole, times that of the larger part
_OTHERS = (0.64, 0.8, 1.0, 1.25, 1.56)  # area of a part's own whole, times that of another
_MEASURED = 2  # times at most that the size is corrected by what anchors measure
_EQUAL = 0.03  # relative difference of areas that is not corrected
_SHARES = (1.0, 0.8, 0.63, 0.5, 0.4, 0.3)  # of the whole, where units differ
_PLAUSIBLE = 0.05, 1.5  # area of an open shape, times that of a whole one of the same unit

_Wholes: TypeAlias = tuple[float, float]


def open_mesh(features: Features) -> Mesh | None:
    """The mesh without what fills its holes, if its boundaries are long enough; else None.

    None, too, where it has several pieces: these have boundaries where they touch.
    """
    mesh = features.shape
    if not isinstance(mesh, Mesh) or components(mesh).max() > 0:
        return None
    if features.copy is None and features.filling:
        own = ~features.is_filling()[mesh.faces].any(axis=1)
        mesh = Mesh(mesh.vertices, mesh.faces[own])
    rim = mesh.vertices[boundary_edges(mesh)]
    length = np.linalg.norm(rim[:, 0] - rim[:, 1], axis=1).sum()
    return mesh if length > _OPEN * np.sqrt(surface_area(mesh)) else None


def is_calibrated(model: Model) -> bool:
    """Whether parts are matched by the bundled model, to whose maps the confidence was fitted."""
    if not model.recipe.is_of_parts:
        return True  # the bundled model is used in its place
    bundled = _bundled()
    assert model.diffusion is not None and bundled.diffusion is not None
    own, known = model.diffusion.weights, bundled.diffusion.weights
    return own.keys() == known.keys() and all(np.array_equal(own[key], known[key]) for key in own)


def best_part_map(
    source: Features,
    target: Features,
    *,
    model: Model,
    scale: Scale = "auto",
    landmarks: IntArray | None = None,
    cache: Cache | None = None,
) -> PartMap | None:
    """The map between shapes of which one or both are parts; None where neither is open.

    Where one is whole and of the same unit, the whole of the other has from two thirds to one and
    a half times its area. Where both are open, the whole is larger than either, and several sizes
    are tried; where units differ, several shares that an open shape could be of its whole.
    Where most is consistent and distances between anchors agree most, see `esd.matching.anchors`,
    sizes are corrected by how much longer these are on one of the shapes. Which of all is right,
    the deformations tell.

    Parameters
    ----------
    model
        Of parts; the bundled one is used in place of any other.
    landmarks : (l, 2)
        Vertices of both shapes that correspond.
    """
    opened = [open_mesh(each) for each in (source, target)]
    if opened == [None, None]:
        return None
    meshes = []
    for mesh, each in zip(opened, (source, target), strict=True):
        assert isinstance(each.shape, Mesh)  # points are never matched as parts
        meshes.append(each.shape if mesh is None else mesh)
    model = model if model.recipe.is_of_parts else _bundled()
    areas = [surface_area(mesh) for mesh in meshes]
    known: tuple[dict[float, Part], ...] = ({}, {})  # by the area of its whole
    seen: list[PartMap] = []

    def tried(wholes: _Wholes) -> _Sized:
        for mesh, whole, parts in zip(meshes, wholes, known, strict=True):
            if whole not in parts:
                first = next(iter(parts.values()), None)
                parts[whole] = part(mesh, whole, model=model, known=first, cache=cache)
        source, target = (parts[whole] for whole, parts in zip(wholes, known, strict=True))
        seen.append(part_map(source, target, landmarks=landmarks))
        return _Sized(wholes, seen[-1])

    def corrected(sized: _Sized) -> _Sized:
        for _ in range(_MEASURED):
            factor = sized.found.anchors.enlargement**2
            if abs(np.log(factor)) < _EQUAL:
                break
            # distances become longer where the source was taken to be too small a part of its whole
            source, target = sized.wholes
            is_open = opened[0] is not None
            other = tried((source / factor, target) if is_open else (source, target * factor))
            if other.score < sized.score:
                break
            sized = other
        return sized

    alike, others = _wholes(areas, [mesh is not None for mesh in opened], scale)
    best: PartMap | None = None
    maps: list[PartMap] = []
    if alike:
        best = corrected(_fitting(map(tried, alike))).found
        maps = list(seen)
    if others and (best is None or best.consistent < _OTHER_UNITS):
        seen.clear()
        found = corrected(_fitting(map(tried, others))).found
        if best is None or found.consistent > best.consistent:
            best, maps = found, list(seen)
    assert best is not None
    return best_registered(maps) or refined_part_map(best)


@dataclass(frozen=True, slots=True, eq=False)
class _Sized:
    """The map between two shapes as parts of wholes of some areas."""

    wholes: _Wholes
    found: PartMap

    @property
    def score(self) -> float:
        """How well the sizes fit."""
        return self.found.consistent + self.found.anchors.agreement


def _fitting(sizes: Iterable[_Sized]) -> _Sized:
    return max(sizes, key=lambda sized: sized.score)


@lru_cache(maxsize=1)
def _bundled() -> Model:
    return load_model(BUNDLED)


def _wholes(
    areas: Sequence[float], is_open: Sequence[bool], scale: Scale
) -> tuple[list[_Wholes], list[_Wholes]]:
    """Areas of the wholes of both shapes to try, each in its own unit.

    Those of one unit, and then those of different units.
    """
    is_plausible = True
    if all(is_open):
        alike = [(max(areas) * factor, max(areas) * factor) for factor in _LARGER]
    else:
        place = is_open.index(False)
        is_plausible = _PLAUSIBLE[0] < areas[1 - place] / areas[place] < _PLAUSIBLE[1]
        alike = [
            (areas[0], areas[0] * factor) if place == 0 else (areas[1] * factor, areas[1])
            for factor in _OTHERS
        ]
    if scale == "same" or (scale == "auto" and all(is_open)):
        return alike, []
    others: list[_Wholes] = []
    for share in _SHARES:
        if is_open[0]:
            others.append((areas[0] / share, areas[1]))
        if is_open[1]:
            others.append((areas[0], areas[1] / share))
    return (alike if scale == "auto" and is_plausible else []), others
