"""OFF: the Object File Format of Geomview."""

from __future__ import annotations

import re
import warnings
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from esd.common import InputError
from esd.mesh.io.polygons import polygon_count, triangulated
from esd.mesh.mesh import Mesh

_MAGIC = re.compile(r"(ST)?C?N?OFF$", re.IGNORECASE)


def read_off(path: Path) -> tuple[npt.NDArray[Any], npt.NDArray[Any], int]:
    """Vertices, faces and the number of polygons of an OFF file.

    Raises
    ------
    InputError
        If it is of another kind, or holds fewer rows than it announces.
    """
    try:
        return _read_triangles(path)
    except (ValueError, Warning):
        return _read_any(path)


def off_text(mesh: Mesh) -> str:
    """An OFF file of a mesh, all digits of its coordinates."""
    lines = [f"OFF\n{len(mesh.vertices)} {len(mesh.faces)} 0"]
    lines += [f"{x!r} {y!r} {z!r}" for x, y, z in mesh.vertices.tolist()]
    lines += [f"3 {a} {b} {c}" for a, b, c in mesh.faces.tolist()]
    return "\n".join([*lines, ""])


def _read_triangles(path: Path) -> tuple[npt.NDArray[Any], npt.NDArray[Any], int]:
    """Triangles, a line each, by numpy; a `ValueError` or warning for anything else."""
    with path.open(encoding="utf-8") as file, warnings.catch_warnings():
        warnings.simplefilter("error")
        magic, counts = file.readline(), file.readline()
        vertex_count, face_count = (int(word) for word in counts.split()[:2])
        if magic.strip() != "OFF" or min(vertex_count, face_count) < 1:
            raise ValueError
        if max(vertex_count, face_count) > path.stat().st_size:  # memory for so many is taken
            raise ValueError
        vertices = np.loadtxt(file, max_rows=vertex_count, usecols=(0, 1, 2), ndmin=2)
        faces = np.loadtxt(file, max_rows=face_count, usecols=(0, 1, 2, 3), ndmin=2, dtype=np.int64)
    if len(vertices) < vertex_count or len(faces) < face_count or (faces[:, 0] != 3).any():
        raise ValueError
    return vertices, faces[:, 1:], face_count


def _read_any(path: Path) -> tuple[npt.NDArray[Any], npt.NDArray[Any], int]:
    """Whatever OFF may hold: comments, colours, normals, polygons."""
    text = path.read_text(encoding="utf-8-sig", errors="replace")
    lines = [line.partition("#")[0].split() for line in text.splitlines()]
    lines = [words for words in lines if words]
    if not lines or not _MAGIC.match(lines[0][0]):
        raise InputError("it does not begin with OFF; is it another kind of file?")
    head, rest = (lines[0][1:], lines[1:]) if len(lines[0]) > 1 else (lines[1], lines[2:])
    if head[:1] in (["BINARY"], ["binary"]):
        raise InputError("it is binary OFF; save it as text.")
    vertex_count, face_count = int(head[0]), int(head[1])
    if min(vertex_count, face_count) < 0:
        raise InputError(f"it announces {vertex_count} vertices and {face_count} faces.")
    rows = [words[:3] for words in rest[:vertex_count]]
    if len(rows) < vertex_count or any(len(row) < 3 for row in rows):
        raise InputError(f"it announces {vertex_count} vertices, {len(rows)} were read.")
    polygons = rest[vertex_count : vertex_count + face_count]
    if len(polygons) < face_count:
        raise InputError(f"it announces {face_count} faces, {len(polygons)} were read.")
    counts = np.array([int(words[0]) for words in polygons], dtype=np.int64)
    if (counts < 0).any():
        raise InputError("a face has a negative number of corners.")
    if any(len(words) <= count for words, count in zip(polygons, counts.tolist(), strict=True)):
        raise InputError("a face has fewer corners than it announces; is the file cut short?")
    corners = np.array(
        list(chain.from_iterable(words[1 : 1 + int(words[0])] for words in polygons)),
        dtype=np.int64,
    )
    vertices = np.array(rows, dtype=float).reshape(-1, 3)
    faces = corners[triangulated(vertices, corners, counts).corners]
    return vertices, faces, polygon_count(path, counts)
