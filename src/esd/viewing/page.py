"""A correspondence as one self-contained web page: both shapes, turned together, with their map."""

from __future__ import annotations

import base64
import json
import os
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from string import Template

import numpy as np
import numpy.typing as npt

from esd.common import FloatArray, InputError, IntArray, whole_file
from esd.matching.correspondence import Correspondence
from esd.matching.transfer import aligned_image
from esd.mesh.convert import MeshLike, as_mesh
from esd.mesh.geometry import is_referenced, surface_area
from esd.mesh.mesh import Mesh
from esd.viewing.colours import UNMATCHED, VIRIDIS, position_colours

_LINES = 300


@dataclass(frozen=True, slots=True)
class Page:
    """A web page that needs neither a server nor a network; notebooks show it."""

    html: str

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the page.

        Raises
        ------
        InputError
            If the name does not end in .html, or the file cannot be written.
        """
        path = check_page_path(path)
        with whole_file(path) as temporary:
            temporary.write_text(self.html, encoding="utf-8")

    def __repr__(self) -> str:
        return f"<Page of {len(self.html) / 1e6:.1f} MB; save it, or show it in a notebook>"

    def _repr_html_(self) -> str:
        escaped = self.html.replace("&", "&amp;").replace('"', "&quot;")
        frame = 'style="width: 100%; height: 560px; border: 0"'
        return f'<iframe srcdoc="{escaped}" {frame}></iframe>'


def check_page_path(path: str | os.PathLike[str]) -> Path:
    """The path, if it ends in .html; raises an `InputError` otherwise."""
    path = Path(path)
    if path.suffix.lower() not in (".html", ".htm"):
        raise InputError(f"'{path}': the name of a page ends in .html.")
    return path


def view(
    source: MeshLike,
    target: MeshLike,
    match: Correspondence,
    *,
    error: FloatArray | None = None,
    source_name: str = "",
    target_name: str = "",
    up: str | None = None,
) -> Page:
    """A page on which both shapes turn together and every match can be looked at.

    The shapes are shown at equal area. The target has colours by position, the map brings them to
    the source. The page also shows confidence, error, lines between matched points, and the source
    on its way to its image on the target.

    Parameters
    ----------
    source, target
        Meshes, or whatever `as_mesh` takes.
    error : (n,), optional
        Geodesic error at each source vertex over √area of the target; NaN where unknown.
    source_name, target_name
        Shown above the shapes.
    up
        The axis, `x`, `y` or `z`, that points up; by default z where the source is longest along
        z, otherwise y.

    Raises
    ------
    InputError
        If the map or the errors do not fit the meshes, or the axis is another.
    """
    source, target = as_mesh(source), as_mesh(target)
    if up is None:
        extents = np.ptp(source.vertices, axis=0)
        up = "z" if extents.argmax() == 2 else "y"
    if up not in ("x", "y", "z"):
        raise InputError(f"`up` must be 'x', 'y' or 'z'; got '{up}'.")
    if error is not None and error.shape != (len(source.vertices),):
        raise InputError(
            f"`error` must have shape ({len(source.vertices)},), a value for each source vertex; "
            f"got {error.shape}."
        )
    source, target = _of_unit_area(source), _of_unit_area(target)
    arrays: dict[str, npt.NDArray[np.generic]] = {
        "source_positions": source.vertices.astype("<f4"),
        "target_positions": target.vertices.astype("<f4"),
        "source_faces": source.faces.astype("<u4"),
        "target_faces": target.faces.astype("<u4"),
        "image": aligned_image(source, target, match).astype("<f4"),
        "map": match.target_index.astype("<i4"),
        "confidence": match.confidence.astype("<f4"),
        "line_order": _spread_matches(source, match).astype("<u4"),
        "target_colours": np.round(255 * position_colours(target)).astype("<u1"),
    }
    top = 0.0
    if error is not None:
        arrays = {"error": error.astype("<f4"), **arrays}
        top = float(np.nanquantile(error, 0.95)) if np.isfinite(error).any() else 0.0
    layout, encoded = _packed(arrays)
    meta = {
        "source": source_name,
        "target": target_name,
        "up": up,
        "radius": max(float(np.linalg.norm(m.vertices, axis=1).max()) for m in (source, target)),
        "error_top": top or 1.0,
        "unmatched": UNMATCHED,
        "ramp": [[int(stop[i : i + 2], 16) / 255 for i in (0, 2, 4)] for stop in VIRIDIS],
        "arrays": layout,
    }
    title = " → ".join(name for name in (source_name, target_name) if name) or "correspondence"
    parts = resources.files("esd.viewing") / "page"
    return Page(
        Template((parts / "page.html").read_text(encoding="utf-8")).substitute(
            title=_escaped(title),
            style=(parts / "viewer.css").read_text(encoding="utf-8"),
            meta=json.dumps(meta, ensure_ascii=True).replace("<", "\\u003c"),
            arrays=encoded,
            library=(parts / "three.min.js").read_text(encoding="utf-8"),
            viewer=(parts / "viewer.js").read_text(encoding="utf-8"),
        )
    )


def _of_unit_area(mesh: Mesh) -> Mesh:
    """The mesh with unit area, its bounding box centred; vertices without a face are drawn in."""
    referenced = is_referenced(mesh)
    used = mesh.vertices[referenced]
    centre = (used.min(axis=0) + used.max(axis=0)) / 2
    vertices = np.where(referenced[:, None], mesh.vertices - centre, 0)
    return Mesh(vertices / np.sqrt(surface_area(mesh)), mesh.faces)


def _spread_matches(source: Mesh, match: Correspondence) -> IntArray:
    """At most 300 matched source vertices, the first of which lie far apart.

    Each is the farthest from those before it, by Euclidean distance.
    """
    matched = np.flatnonzero(match.is_matched() & is_referenced(source))
    points = source.vertices[matched]
    chosen = np.zeros(min(_LINES, len(points)), dtype=np.int64)
    distance = np.full(len(points), np.inf)
    for i in range(1, len(chosen)):
        np.minimum(distance, ((points - points[chosen[i - 1]]) ** 2).sum(axis=1), out=distance)
        chosen[i] = distance.argmax()
    return matched[chosen]


def _packed(
    arrays: dict[str, npt.NDArray[np.generic]],
) -> tuple[list[tuple[str, str, int, int]], str]:
    """Name, kind, first byte and length of each array, and all bytes in base64.

    Arrays of four-byte elements precede those of single bytes, so that all are aligned.
    """
    layout, content = [], b""
    for name, array in sorted(arrays.items(), key=lambda item: -item[1].itemsize):
        kind = f"{array.dtype.kind}{array.dtype.itemsize}"
        layout.append((name, kind, len(content), array.size))
        content += array.tobytes()
    return layout, base64.b64encode(content).decode("ascii")


def _escaped(text: str) -> str:
    return text.replace("&", "&amp;").replace("<", "&lt;")
