"""STL, binary and text: triangles that share no vertices."""

from __future__ import annotations

import codecs
import re
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from esd.common import FloatArray, InputError, IntArray
from esd.mesh.mesh import Mesh

_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_CORNER = re.compile(rb"\bvertex\s+(\S+)\s+(\S+)\s+(\S+)", re.IGNORECASE)


def read_stl(path: Path) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
    """Vertices and faces of an STL file.

    Corners at exactly one place become one vertex, in order of first appearance. Bytes after the
    last triangle of a binary file are left out.

    Raises
    ------
    InputError
        If it is no STL file, or is cut short.
    """
    content = path.read_bytes().removeprefix(codecs.BOM_UTF8)
    announced = int.from_bytes(content[80:84], "little") if len(content) >= 84 else -1
    size = 84 + 50 * announced
    is_text = content.lstrip()[:5].lower() == b"solid" and len(content) != size
    if is_text and b"facet" in content.lower():
        return _joined(_text_corners(content))
    if announced < 0 or is_text or (content[:512].isascii() and b"\x00" not in content[:512]):
        raise InputError("it is no STL file: neither binary nor `solid` with `facet` lines.")
    if announced == 0:
        raise InputError("there are no triangles in it.")
    if len(content) < size:
        raise InputError(
            f"it announces {announced} triangles and holds {(len(content) - 84) // 50}; "
            "it is cut short."
        )
    triangles = np.frombuffer(content, _TRIANGLE, count=announced, offset=84)
    return _joined(triangles["corners"].astype(float))


def stl_bytes(mesh: Mesh) -> bytes:
    """A binary STL file of a mesh."""
    triangles = np.zeros(len(mesh.faces), dtype=_TRIANGLE)
    corners = mesh.vertices[mesh.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    triangles["normal"] = normals / np.where(length > 0, length, 1)
    triangles["corners"] = corners
    return bytes(80) + len(triangles).to_bytes(4, "little") + triangles.tobytes()


def stl_vertices(mesh: Mesh) -> IntArray:
    """Which vertex each vertex of a mesh becomes in an STL file that is read back, (n,).

    STL holds corners of 32 bits: vertices come in the order of the faces, those at one place are
    one, and those without a face are lost: -1.
    """
    index = np.full(len(mesh.vertices), -1, dtype=np.int64)
    corners = mesh.vertices[mesh.faces].astype(np.float32).astype(float)
    index[mesh.faces.ravel()] = _joined(corners)[1].ravel()
    return index


def _text_corners(content: bytes) -> FloatArray:
    lowered = content.lower()
    corners = np.array(_CORNER.findall(content)).astype(float)
    facets = len(re.findall(rb"\bfacet\s+normal\b", lowered))
    if b"endsolid" not in lowered or len(corners) != 3 * facets or not facets:
        raise InputError(
            f"it has {facets} triangles and {len(corners)} corners; expected `endsolid` after "
            "three corners for each. Is it cut short?"
        )
    return np.asarray(corners.reshape(-1, 3, 3))


def _joined(corners: FloatArray) -> tuple[FloatArray, IntArray]:
    """Vertices and faces (m, 3) of corners (m, 3, 3): equal ones joined, as they first appear."""
    _, first, inverse = np.unique(
        corners.reshape(-1, 3) + 0.0, axis=0, return_index=True, return_inverse=True
    )  # -0.0 is 0.0
    order = np.argsort(first)
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    return corners.reshape(-1, 3)[first[order]], rank[inverse.reshape(-1)].reshape(-1, 3)
