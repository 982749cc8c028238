"""Wavefront OBJ: positions, faces, texture coordinates and names of materials."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from esd.common import FloatArray, InputError, IntArray
from esd.mesh.io.polygons import triangulated
from esd.mesh.mesh import Mesh


@dataclass(frozen=True, slots=True, eq=False)
class ObjFile:
    """What is used of an OBJ file.

    Parameters
    ----------
    vertices : (n, 3)
    faces : (m, 3)
        Triangles of its polygons, in their order.
    polygon_count
    coordinates : (t, 2)
        Places on the image.
    texture_faces : (m, 3)
        Into `coordinates`; -1 where a corner has none.
    material : (m,)
        Into `materials`; -1 for faces before the first `usemtl`.
    materials
        Names, in order of appearance.
    libraries
        Names of material files.
    """

    vertices: npt.NDArray[Any]
    faces: IntArray
    polygon_count: int
    coordinates: FloatArray
    texture_faces: IntArray
    material: IntArray
    materials: tuple[str, ...]
    libraries: tuple[str, ...]


def read_obj(path: Path) -> ObjFile:
    """The content of an OBJ file.

    Read here because the libraries split vertices along texture seams or drop those without a
    face, and then a map no longer fits the user's file. Negative indices count back from the last
    element read so far. Lines (`l`) and free-form surfaces are left out.

    Raises
    ------
    InputError
        If there are no vertices, or an index is 0 or beyond what was read so far.
    """
    text = path.read_text(encoding="utf-8-sig", errors="replace").replace("\\\r\n", " ")
    lines = [line.partition("#")[0].split() for line in text.replace("\\\n", " ").splitlines()]
    lines = [words for words in lines if words]
    kinds = np.array([words[0] for words in lines])
    positions = [words[1:4] for words in lines if words[0] == "v"]
    if not positions:
        raise InputError("there are no vertices in it.")
    if any(len(position) < 3 for position in positions):
        raise InputError("a vertex has fewer than three coordinates; is the file cut short?")
    texture = [(*words[1:3], "0")[:2] for words in lines if words[0] == "vt"]  # v may be left out
    is_face = kinds == "f"
    polygons = [words[1:] for words in lines if words[0] == "f"]
    counts = np.array([len(words) for words in polygons], dtype=np.int64)
    corners = [corner.split("/") for words in polygons for corner in words]
    vertex = _indices([c[0] for c in corners], np.cumsum(kinds == "v")[is_face], counts)
    place = _indices(
        [c[1] if len(c) > 1 else "" for c in corners], np.cumsum(kinds == "vt")[is_face], counts
    )
    names = [" ".join(words[1:]) for words in lines if words[0] == "usemtl"]
    materials = tuple(dict.fromkeys(names))
    numbers = {name: number for number, name in enumerate(materials)}
    used = np.array([-1, *(numbers[name] for name in names)])
    vertices = np.array(positions, dtype=float)
    triangles = triangulated(vertices, vertex, counts)
    return ObjFile(
        vertices=vertices,
        faces=vertex[triangles.corners],
        polygon_count=len(polygons),
        coordinates=np.array(texture, dtype=float).reshape(-1, 2),
        texture_faces=place[triangles.corners],
        material=used[np.cumsum(kinds == "usemtl")[is_face]][triangles.polygon],
        materials=materials,
        libraries=tuple(" ".join(words[1:]) for words in lines if words[0] == "mtllib"),
    )


def obj_text(mesh: Mesh) -> str:
    """An OBJ file of a mesh, all digits of its coordinates."""
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in mesh.vertices.tolist()]
    lines += [f"f {a} {b} {c}" for a, b, c in (mesh.faces + 1).tolist()]
    return "\n".join([*lines, ""])


def _indices(words: list[str], seen: IntArray, counts: IntArray) -> IntArray:
    """Indices from 0 of corners; -1 where there is no word.

    `seen` says how many elements were read before each face, from which negative ones count back.
    """
    missing = np.array([not word for word in words], dtype=bool)
    index = np.array([int(word or 1) for word in words], dtype=np.int64)
    if (index == 0).any():
        raise InputError("faces count their vertices from 1; one has 0.")
    back = index < 0
    index = np.where(back, np.repeat(seen, counts) + index, index - 1)
    if (index[back] < 0).any():
        raise InputError("a face counts back to before the first vertex.")
    index[missing] = -1
    return index
