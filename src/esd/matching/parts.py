"""Whether shapes are parts of a whole, at which scale, and the map between them then."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import lru_cache
from typing import Literal, TypeAlias

import numpy as np

from esd.common import IntArray
from esd.learning.model import Model, load_model
from esd.matching.features import Features
from esd.matching.partial import Part, PartMap, part, part_map
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
_FITS = 0.9  # consistent share beyond which nothing else is tried
_OTHER_UNITS = 0.25  # the same below which `auto` gives up that a part and a whole have one unit
_LARGER = (1.0, 1.25, 1.6, 2.0)  # area of the whole, times that of the larger part
_OTHERS = (1.0, 0.8, 1.25, 0.64, 1.56)  # area of a part's own whole, times that of another
_MEASURED = 3  # times at most that the size is corrected by what a map measures
_EQUAL = 0.03  # relative difference of areas that is not corrected
_AS_GOOD = 0.03  # consistent share that a map may lose by that
_SHARES = (1.0, 0.8, 0.63, 0.5, 0.4, 0.3)  # of the whole, where units differ
_PLAUSIBLE = 0.05, 1.5  # area of an open shape, times that of a whole one of the same unit


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
    are tried; where units differ, several shares that an open shape could be of its whole. A size
    is corrected by how much larger images are than what is mapped consistently. The most consistent
    map is taken, see `esd.matching.partial.consistent_share`.

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
    model = model if model.diffusion is not None else _bundled()
    areas = [surface_area(mesh) for mesh in meshes]
    best: PartMap | None = None
    was_same = True
    known: dict[tuple[int, float], Part] = {}

    def mapped(wholes: tuple[float, float]) -> PartMap:
        for place, whole in enumerate(wholes):
            if (place, whole) not in known:
                known[place, whole] = part(meshes[place], whole, model=model, cache=cache)
        return part_map(known[0, wholes[0]], known[1, wholes[1]], landmarks=landmarks)

    def settled(found: PartMap, wholes: tuple[float, float]) -> PartMap:
        """The map at the size that it measures itself, unless it is clearly less consistent."""
        for _ in range(_MEASURED):
            if abs(np.log(found.enlargement)) < _EQUAL or found.consistent < _OTHER_UNITS:
                break
            # images are larger where the source was taken to be too small a part of its whole
            if opened[0] is not None:
                wholes = wholes[0] / found.enlargement, wholes[1]
            else:
                wholes = wholes[0], wholes[1] * found.enlargement
            other = mapped(wholes)
            if other.consistent < found.consistent - _AS_GOOD:
                break
            found = other
        return found

    for is_same, wholes in _wholes(areas, [mesh is not None for mesh in opened], scale):
        enough = _FITS if is_same == was_same else _OTHER_UNITS
        if best is not None and best.consistent >= enough:
            break
        was_same = is_same
        found = mapped(wholes)
        if best is None or found.consistent > best.consistent:
            best = settled(found, wholes)
    return best


@lru_cache(maxsize=1)
def _bundled() -> Model:
    return load_model(BUNDLED)


def _wholes(
    areas: Sequence[float], is_open: Sequence[bool], scale: Scale
) -> Iterator[tuple[bool, tuple[float, float]]]:
    """Areas of the wholes of both shapes to try, each in its own unit, and whether it is one."""
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
    if scale == "same" or (scale == "auto" and is_plausible):
        yield from ((True, wholes) for wholes in alike)
    if scale == "same" or (scale == "auto" and all(is_open)):
        return
    for share in _SHARES:
        if all(is_open):
            yield False, (areas[0] / share, areas[1])
            yield False, (areas[0], areas[1] / share)
        elif is_open[0]:
            yield False, (areas[0] / share, areas[1])
        else:
            yield False, (areas[0], areas[1] / share)
