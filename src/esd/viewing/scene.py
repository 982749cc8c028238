"""What the viewer in a browser shows of a map: arrays, and what is to be said of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree

from esd.common import BoolArray, FloatArray, InputError, IntArray
from esd.matching.confidence import Judgement, judgement
from esd.matching.correspondence import Correspondence
from esd.matching.transfer import aligned_image, aligning_rotation
from esd.mesh.convert import MeshLike, as_mesh
from esd.mesh.geodesics import geodesic_graph
from esd.mesh.geometry import edge_lengths, face_areas, is_referenced, surface_area, vertex_areas
from esd.mesh.mesh import Mesh
from esd.mesh.sampling import spread
from esd.viewing.colours import UNMATCHED, VIRIDIS, position_colours
from esd.viewing.upright import AXES, default_up

_LINES = 300
_MOST_SPREAD = 10_000  # vertices among which those of lines are looked for
_PLACES = 8  # worst places that are listed at most
_BAD_ERROR, _BAD_CONFIDENCE = 0.05, 0.9  # a place with less error or more confidence is not bad
_APART = 0.15  # in √area: least distance of two of them
_NEAR = 0.03  # in √area: values are means over so much around
_REACH = 0.05  # in √area: target vertices farther from all images have no counterpart
_FEW_EDGES = 2  # nor have those farther than so many edges of a coarse source

Field = dict[str, Any]


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """What the viewer shows.

    Parameters
    ----------
    meta
        Names, figures and scales, of types that JSON has.
    arrays
        By name, of four-byte or one-byte elements, little-endian.
    """

    meta: dict[str, Any]
    arrays: dict[str, npt.NDArray[np.generic]]

    def packed(self) -> tuple[dict[str, Any], bytes]:
        """The meta data with a table of contents, `arrays`, and the bytes of all arrays.

        The table has name, kind, first byte and length of each. Arrays of four-byte elements
        precede those of single bytes, so that all are aligned.
        """
        layout, content = [], bytearray()
        for name, array in sorted(self.arrays.items(), key=lambda item: -item[1].itemsize):
            kind = f"{array.dtype.kind}{array.dtype.itemsize}"
            layout.append((name, kind, len(content), array.size))
            content += array.tobytes()
        return {**self.meta, "arrays": layout}, bytes(content)


def scene(
    source: MeshLike,
    target: MeshLike,
    match: Correspondence,
    *,
    error: FloatArray | None = None,
    source_name: str = "",
    target_name: str = "",
    model: str | None = None,
    up: str | None = None,
) -> Scene:
    """What the viewer shows of a map between two meshes.

    Both are scaled to unit area. See `esd.viewing.page.view` for the parameters and errors.
    """
    source, target = as_mesh(source), as_mesh(target)
    up = default_up(source) if up is None else up
    if up not in AXES:
        raise InputError(f"`up` must be one of {', '.join(AXES)}; got '{up}'.")
    if error is not None and error.shape != (len(source.vertices),):
        raise InputError(
            f"`error` must have shape ({len(source.vertices)},), a value for each source vertex; "
            f"got {error.shape}."
        )
    judged = match.judgement or _judged(source, target, match)
    source, target = of_unit_area(source), of_unit_area(target)
    image = aligned_image(source, target, match)
    stretch = _stretch(source, target, match)
    values = {"confidence": match.confidence}
    if error is not None:
        values["error"] = error
    values |= {"distance": match.distance, "stretch": stretch}
    values = {name: np.where(np.isfinite(v), v, np.nan) for name, v in values.items()}
    fields = [_field(name, value) for name, value in values.items() if np.isfinite(value).any()]
    colours = np.round(255 * position_colours(target))
    comes_from = _comes_from(source, target, match)
    arrays: dict[str, npt.NDArray[np.generic]] = {
        **shape_arrays("source", source),
        **shape_arrays("target", target),
        **{field["name"]: values[field["name"]].astype("<f4") for field in fields},
        "image": image.astype("<f4"),
        "map": match.target_index.astype("<i4"),
        "comes_from": comes_from.astype("<i4"),
        "line_order": _spread_matches(source, match).astype("<u4"),
        "target_colours": colours.astype("<u1"),
    }
    meta = {
        "source": source_name,
        "target": target_name,
        "up": up,
        "radius": max(float(np.linalg.norm(m.vertices, axis=1).max()) for m in (source, target)),
        "rotation": aligning_rotation(source, target, match).ravel().tolist(),
        **PALETTE,
        "fields": fields,
        "lacking": [_share(source, ~match.is_matched()), _share(target, comes_from < 0)],
        "verdict": _verdict(judged),
        "statistics": _statistics(source, target, match, values, judged, model),
        "places": _worst_places(source, match, values),
    }
    return Scene(meta, arrays)


PALETTE = {
    "unmatched": UNMATCHED,
    "ramp": [[int(stop[i : i + 2], 16) / 255 for i in (0, 2, 4)] for stop in VIRIDIS],
}
"""Colours that the viewer paints values with."""


def of_unit_area(mesh: Mesh) -> Mesh:
    """The mesh with unit area, its bounding box centred; vertices without a face are drawn in."""
    referenced = is_referenced(mesh)
    used = mesh.vertices[referenced]
    centre = (used.min(axis=0) + used.max(axis=0)) / 2
    vertices = np.where(referenced[:, None], mesh.vertices - centre, 0)
    return Mesh(vertices / np.sqrt(surface_area(mesh)), mesh.faces)


def shape_arrays(name: str, mesh: Mesh) -> dict[str, npt.NDArray[np.generic]]:
    """The arrays of one shape, by name with its own before."""
    return {
        f"{name}_positions": mesh.vertices.astype("<f4"),
        f"{name}_faces": mesh.faces.astype("<u4"),
    }


def _judged(source: Mesh, target: Mesh, match: Correspondence) -> Judgement | None:
    """The judgement that follows from the confidence, where that is known.

    Vertices without a match do not count: a file does not say why they have none.
    """
    counted = is_referenced(source) & np.isfinite(match.confidence) & match.is_matched()
    if not counted.any():
        return None
    return judgement(source, target, match.target_index, match.confidence, counted=counted)


def _field(name: str, values: FloatArray) -> Field:
    """What is to be known of values at the source's vertices to show them.

    `low` and `high` are the ends of a scale that is the same for all maps; of distances, whose
    unit is the model's own, a round number beyond nearly all of them.
    """
    if name == "confidence":
        return _scale(name, "Confidence", 0.0, 1.0, 1.0, "")
    if name == "error":
        return _scale(name, "Error", 0.0, 0.25, 100.0, "% of √area")
    if name == "stretch":
        return _scale(name, "Stretch", -3.0, 3.0, 1.0, "log₂ of area")
    return _scale(name, "Distance", 0.0, round_above(float(np.nanquantile(values, 0.99))), 1.0, "")


def _scale(name: str, title: str, low: float, high: float, factor: float, unit: str) -> Field:
    return {
        "name": name,
        "title": title,
        "low": low,
        "high": high,
        "factor": factor,
        "unit": unit,
    }


def round_above(value: float) -> float:
    """The least of 1, 2 and 5 times a power of ten that is not below a value."""
    if value <= 0:
        return 1.0
    power = 10.0 ** np.floor(np.log10(value))
    return float(next(step * power for step in (1, 2, 5, 10) if step * power >= 0.999 * value))


def _stretch(source: Mesh, target: Mesh, match: Correspondence) -> FloatArray:
    """How much the map enlarges the surface around each vertex: log₂ of areas, (n,); NaN for none.

    Areas are of all faces at the vertex whose corners are matched. Shrunk to nothing is −3.
    """
    image = match.target_index[source.faces]
    mapped = (image >= 0).all(axis=1)
    area, face = np.zeros(len(image)), face_areas(source)
    area[mapped] = face_areas(Mesh(target.vertices, image[mapped])) if mapped.any() else 0.0
    before, after = np.zeros(len(source.vertices)), np.zeros(len(source.vertices))
    for corner in source.faces.T:
        np.add.at(before, corner[mapped], face[mapped])
        np.add.at(after, corner[mapped], area[mapped])
    ratio = np.divide(after, before, out=np.full(len(before), np.nan), where=before > 0)
    return np.asarray(np.log2(np.maximum(ratio, 2.0**-3)))


def _comes_from(source: Mesh, target: Mesh, match: Correspondence) -> IntArray:
    """For each target vertex, (m,), the source vertex whose value is shown there; -1 for none.

    That of the best match whose image is nearest along the surface, if it is near.
    """
    usable = np.flatnonzero(match.is_matched() & is_referenced(source))
    if len(usable) == 0:
        return np.full(len(target.vertices), -1)
    usable = usable[np.lexsort((match.distance[usable], match.target_index[usable]))]
    hit, first = np.unique(match.target_index[usable], return_index=True)
    of_image = np.full(len(target.vertices) + 1, -1)  # one more, for none
    of_image[hit] = usable[first]
    nearest = geodesic_graph(target).nearest_source(hit)
    away = np.linalg.norm(target.vertices - target.vertices[nearest], axis=1)
    reach = max(_REACH, _FEW_EDGES * float(edge_lengths(source).mean()))
    return np.where((nearest >= 0) & (away < reach), of_image[nearest], -1)


def _spread_matches(source: Mesh, match: Correspondence) -> IntArray:
    """At most 300 matched source vertices, the first of which lie far apart.

    Each is the farthest from those before it, by Euclidean distance, of all or of every k-th.
    """
    matched = np.flatnonzero(match.is_matched() & is_referenced(source))
    matched = matched[:: -(-len(matched) // _MOST_SPREAD) or 1]
    return matched[spread(source.vertices[matched], _LINES)] if len(matched) else matched


def _verdict(judged: Judgement | None) -> dict[str, str] | None:
    if judged is None:
        return None
    share = f"about {judged.expected_accuracy:.0%} of the matches within 5 % of the diameter"
    return {"word": judged.verdict, "share": share, "advice": judged.advice}


def _statistics(
    source: Mesh,
    target: Mesh,
    match: Correspondence,
    values: dict[str, FloatArray],
    judged: Judgement | None,
    model: str | None,
) -> list[tuple[str, str]]:
    """Names of figures and figures, in the order in which they are shown."""
    matched = match.is_matched()
    found = [("Model", model)] if model else []
    if judged is not None and judged.candidate:
        found.append(("Candidate", judged.candidate))
    found.append(("Matched", f"{matched.sum():,} of {len(matched):,} vertices"))
    found.append(("Covers", f"{match.coverage(len(target.vertices)):.0%} of the target's vertices"))
    if judged is not None:
        found.append(("Orientation", f"{judged.orientation:+.2f}"))
        if judged.is_mirrored:
            found.append(("Mirrored", "the source, before it was matched"))
    error = mean_error(source, values["error"]) if "error" in values else None
    if error is not None:
        found.append(("Mean error", f"{100 * error:.1f} % of √area"))
    for name, mesh in (("Source", source), ("Target", target)):
        found.append((name, f"{len(mesh.vertices):,} vertices, {len(mesh.faces):,} faces"))
    return found


def mean_error(source: Mesh, error: FloatArray) -> float | None:
    """Mean of errors (n,) over the source's area, of those that are finite; None if none is."""
    known = np.isfinite(error)
    if not known.any():
        return None
    # vertices without a face have no area, and may be all that are known
    return float(np.average(error[known], weights=vertex_areas(source)[known] + 1e-12))


def _share(mesh: Mesh, chosen: BoolArray) -> float:
    """The share of the area that belongs to some vertices."""
    areas = vertex_areas(mesh)
    return float(areas[chosen].sum() / areas.sum())


def _worst_places(
    source: Mesh, match: Correspondence, values: dict[str, FloatArray]
) -> list[dict[str, Any]]:
    """Source vertices around which the map is bad, worst first, and far apart.

    By the error, where it is known, else the confidence, as means over what is near.
    """
    by_error = "error" in values and np.isfinite(values["error"]).any()
    name = "error" if by_error else "confidence"
    badness = values[name] if by_error else -values[name]
    least = _BAD_ERROR if by_error else -_BAD_CONFIDENCE
    usable = np.flatnonzero(np.isfinite(badness) & match.is_matched() & is_referenced(source))
    if len(usable) == 0:
        return []
    points = source.vertices[usable]
    mean = _near_means(points, badness[usable])
    left: BoolArray = np.ones(len(usable), dtype=bool)
    places: list[dict[str, Any]] = []
    while left.any() and len(places) < _PLACES:
        worst = int(np.where(left, mean, -np.inf).argmax())
        if mean[worst] < least:
            break
        vertex = int(usable[worst])
        places.append({"vertex": vertex, "field": name, "value": float(abs(mean[worst]))})
        left &= np.linalg.norm(points - points[worst], axis=1) > _APART
    return places


def _near_means(points: FloatArray, values: FloatArray) -> FloatArray:
    """Means of values (p,) over the points around each, at most sixteen."""
    count = min(16, len(points))
    distance, index = KDTree(points).query(points, k=count)
    distance, index = distance.reshape(len(points), -1), index.reshape(len(points), -1)
    near = distance <= _NEAR
    return np.asarray((values[index] * near).sum(axis=1) / near.sum(axis=1))
