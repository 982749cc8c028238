"""Wavefront OBJ: positions, faces, texture coordinates and names of materials."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from esd.common import FloatArray, InputError, IntArray
from esd.mesh.io.polygons import polygon_count, triangulated
from esd.mesh.mesh import Mesh

_NONE = -(2**63)  # the index of what a corner does not have


@dataclass(frozen=True, slots=True, eq=False)
class ObjFile:
    """What is used of an OBJ file.

    Parameters
    ----------
    vertices : (n, 3)
    colours : (n, 3)
        Numbers after the coordinates: red, green and blue; (0, 3) if there are not so many.
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
    colours: FloatArray
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
    index, index_of_place = _corners([corner for words in polygons for corner in words])
    vertex = _from_zero(index, np.cumsum(kinds == "v")[is_face], counts)
    place = _from_zero(index_of_place, np.cumsum(kinds == "vt")[is_face], counts)
    names = [" ".join(words[1:]) for words in lines if words[0] == "usemtl"]
    materials = tuple(dict.fromkeys(names))
    numbers = {name: number for number, name in enumerate(materials)}
    used = np.array([-1, *(numbers[name] for name in names)])
    vertices = np.array(positions, dtype=float)
    triangles = triangulated(vertices, vertex, counts)
    return ObjFile(
        vertices=vertices,
        colours=_colours(lines, len(positions)),
        faces=vertex[triangles.corners],
        polygon_count=polygon_count(path, counts),
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


def obj_text_like(mesh: Mesh, original: Path, *, library: str = "") -> str:
    """An OBJ file with the vertices of a mesh, and all else of a file that has as many.

    Polygons, groups, names of materials, texture coordinates and colours of vertices stay. Normals
    and material files are left out: they are not those of the new file, which names `library`.
    """
    text = original.read_text(encoding="utf-8-sig", errors="replace").replace("\\\r\n", " ")
    rows = iter(mesh.vertices.tolist())
    lines = [f"mtllib {library}"] if library else []
    for line in text.replace("\\\n", " ").splitlines():
        words = line.partition("#")[0].split()
        kind = words[0] if words else ""
        if kind == "v":
            lines.append(" ".join(["v", *map(repr, next(rows)), *words[4:]]))
        elif kind == "f":
            corners = (corner.split("/")[:2] for corner in words[1:])
            lines.append(" ".join(["f", *("/".join(filter(None, each)) for each in corners)]))
        elif kind not in ("vn", "mtllib"):
            lines.append(line)
    return "\n".join([*lines, ""])


def _colours(lines: list[list[str]], count: int) -> FloatArray:
    """Colours (n, 3) of the vertices, as MeshLab and ZBrush write them; (0, 3) for none."""
    rows = [words[4:7] for words in lines if words[0] == "v" and len(words) >= 7]
    try:
        return np.array(rows if len(rows) == count else [], dtype=float).reshape(-1, 3)
    except ValueError:
        return np.zeros((0, 3))


def _corners(words: list[str]) -> tuple[IntArray, IntArray]:
    """Index of the vertex and of the place on the image of each corner, or `_NONE`.

    They are as the file counts them: from 1, or back from the end.
    """
    slashes = {word.count("/") for word in words}
    text = " ".join(words)
    if len(slashes) == 1 and "//" not in text and "/ " not in f"{text} ":
        # all corners are alike, such as v/t or v/t/n, which takes half of the time
        columns = np.array(list(map(int, text.replace("/", " ").split())), dtype=np.int64)
        columns = columns.reshape(len(words), slashes.pop() + 1)
        missing = np.full(len(words), _NONE)
        return columns[:, 0], columns[:, 1] if columns.shape[1] > 1 else missing
    parts = [word.split("/") for word in words]
    first = [int(part[0]) for part in parts]
    second = [int(part[1]) if len(part) > 1 and part[1] else _NONE for part in parts]
    return np.array(first, dtype=np.int64), np.array(second, dtype=np.int64)


def _from_zero(index: IntArray, seen: IntArray, counts: IntArray) -> IntArray:
    """Indices from 0 of corners; -1 where there is none.

    `seen` says how many elements were read before each face, from which negative ones count back.
    """
    missing = index == _NONE
    index = np.where(missing, 1, index)
    if (index == 0).any():
        raise InputError("faces count their vertices from 1; one has 0.")
    back = index < 0
    index = np.where(back, np.repeat(seen, counts) + index, index - 1)
    if (index[back] < 0).any():
        raise InputError("a face counts back to before the first vertex.")
    index[missing] = -1
    return index
