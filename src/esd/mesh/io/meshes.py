"""Reading and writing meshes; vertex order and count are those of the file."""

from __future__ import annotations

import io
import json
import logging
import os
import struct
import warnings
from itertools import pairwise
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
import numpy.typing as npt

from esd.common import InputError, IntArray, whole_file
from esd.mesh.mesh import Mesh

FORMATS = (".off", ".obj", ".ply", ".stl", ".glb", ".gltf")
"""Suffixes of the mesh files that are read and written."""

POINT_FORMATS = (".xyz",)
"""Suffixes of the files that hold points alone; `.ply` may, too."""

_LARGEST_FILE = 2**32
_MOST_VERTICES = 5 * 10**7  # of a scene with all its instances

_log = logging.getLogger(__name__)


def read_mesh(path: str | os.PathLike[str]) -> Mesh:
    """The mesh in a file, its vertices in the order and number of the file.

    Polygons are cut into triangles from their first corner, and the log says how many. STL files
    hold no shared vertices: corners at exactly one place become one vertex, in order of first
    appearance. The parts of a glTF scene are placed and joined.

    Parameters
    ----------
    path
        A file with one of the suffixes in `FORMATS`.

    Raises
    ------
    InputError
        If there is no such file, or no triangle mesh in it, or it is cut short.
    """
    vertices, faces = read_arrays(path)
    try:
        return Mesh(vertices, faces)
    except InputError as error:
        raise InputError(f"'{path}': {error}") from error


def read_arrays(path: str | os.PathLike[str]) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
    """Vertices (n, 3) and faces (m, 3) in a file, as they are.

    Coordinates that are not finite and
    indices beyond the last vertex are kept. Without faces, m is zero.

    Parameters
    ----------
    path
        A file with one of the suffixes in `FORMATS` or `POINT_FORMATS`. An XYZ file holds a
        point a line, its first three numbers.

    Raises
    ------
    InputError
        If there is no such file, or nothing of the kind in it, or it is cut short.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in FORMATS + POINT_FORMATS:
        known = ", ".join(FORMATS + POINT_FORMATS)
        raise InputError(f"'{path}' is not a mesh file; expected one of {known}.")
    if not path.is_file():
        raise InputError(f"There is no file '{path}'.")
    if path.stat().st_size > _LARGEST_FILE:
        raise InputError(f"'{path}' is larger than 4 GiB; simplify the mesh first.")
    read = {".off": _read_off, ".obj": _read_obj, ".xyz": _read_xyz}.get(suffix, _read_by_trimesh)
    try:
        return read(path)
    except OSError as error:
        raise InputError(f"'{path}' cannot be read: {error.strerror or error}.") from error
    except InputError as error:
        raise InputError(f"'{path}': {error}") from error
    except Exception as error:  # whatever a parser stumbles over is bad input
        kind = path.suffix[1:].upper()
        faulty = isinstance(error, AttributeError | TypeError | KeyError | IndexError)
        why = "it is damaged, or of another format" if faulty else str(error)
        raise InputError(f"'{path}' cannot be read as {kind}: {why}") from error


def write_mesh(mesh: Mesh, path: str | os.PathLike[str]) -> None:
    """Write a mesh; the suffix of the path chooses the format.

    Coordinates keep all their digits in OFF, OBJ and PLY, and seven in STL and glTF, whose numbers
    are 32 bits long. STL keeps neither the order nor the sharing of vertices.

    Raises
    ------
    InputError
        If the suffix is unknown or the file cannot be written.
    """
    import trimesh

    path = check_mesh_path(path)
    suffix = path.suffix.lower()
    if suffix == ".ply":
        content = _ply(mesh)
    else:
        options = {"digits": 17} if suffix in (".off", ".obj") else {}
        surface = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
        content = surface.export(file_type=suffix[1:], **options)
    with whole_file(path) as temporary:
        temporary.write_bytes(content if isinstance(content, bytes) else content.encode())


def check_mesh_path(path: str | os.PathLike[str]) -> Path:
    """The path, if a mesh can be written to it; raises an `InputError` otherwise."""
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in FORMATS or suffix == ".gltf":  # .gltf scatters over several files
        written = ", ".join(name for name in FORMATS if name != ".gltf")
        raise InputError(f"'{path}': expected a suffix among {written}.")
    return path


def _ply(mesh: Mesh) -> bytes:
    """A binary PLY file; trimesh would write 32 bits of each coordinate."""
    faces = np.empty(len(mesh.faces), dtype=[("count", "u1"), ("corners", "<i4", 3)])
    faces["count"], faces["corners"] = 3, mesh.faces
    head = (
        f"ply\nformat binary_little_endian 1.0\nelement vertex {len(mesh.vertices)}\n"
        "property double x\nproperty double y\nproperty double z\n"
        f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    return head.encode() + mesh.vertices.astype("<f8").tobytes() + faces.tobytes()


def _read_by_trimesh(path: Path) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
    import trimesh

    suffix = path.suffix.lower()
    if suffix in (".glb", ".gltf"):
        _check_scene(_scene_document(path))
    scene = trimesh.load_scene(path, process=False, skip_materials=True)
    clouds = [g for g in scene.geometry.values() if isinstance(g, trimesh.PointCloud)]
    if clouds and len(clouds) == len(scene.geometry):
        points = np.concatenate([np.asarray(cloud.vertices) for cloud in clouds])
        return points, np.zeros((0, 3), dtype=np.int64)
    loaded = scene.to_mesh()
    vertices, faces = np.asarray(loaded.vertices), np.asarray(loaded.faces)
    if suffix == ".stl" and len(vertices):
        _, first, inverse = np.unique(vertices, axis=0, return_index=True, return_inverse=True)
        order = np.argsort(first)
        rank = np.empty_like(order)
        rank[order] = np.arange(len(order))
        vertices, faces = vertices[first[order]], rank[inverse.reshape(-1)][faces]
    declared = _declared_counts(path)
    if declared is not None:
        vertex_count, face_count = declared
        if len(vertices) != vertex_count and len(faces):
            raise InputError(f"it announces {vertex_count} vertices, {len(vertices)} were read.")
        if len(faces) < face_count:
            raise InputError(f"it announces {face_count} faces, {len(faces)} were read.")
        _tell_triangulation(path, face_count, len(faces))
    return vertices, faces


def _read_off(path: Path) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
    """Triangles, a line each, by numpy: in a sixth of the time, and trimesh takes 0.3 s to import.

    Whatever else OFF may hold, faults included, is left to trimesh.
    """
    try:
        with path.open(encoding="utf-8") as file, warnings.catch_warnings():
            warnings.simplefilter("error")
            magic, counts = file.readline(), file.readline()
            vertex_count, face_count = (int(word) for word in counts.split()[:2])
            if magic.strip() != "OFF" or min(vertex_count, face_count) < 1:
                raise ValueError
            if max(vertex_count, face_count) > path.stat().st_size:  # memory for so many is taken
                raise ValueError
            vertices = np.loadtxt(file, max_rows=vertex_count, usecols=(0, 1, 2), ndmin=2)
            faces = np.loadtxt(
                file, max_rows=face_count, usecols=(0, 1, 2, 3), ndmin=2, dtype=np.int64
            )
    except (ValueError, Warning):
        return _read_by_trimesh(path)
    if len(vertices) < vertex_count or len(faces) < face_count or (faces[:, 0] != 3).any():
        return _read_by_trimesh(path)
    return vertices, faces[:, 1:]


def _scene_document(path: Path) -> dict[str, Any]:
    """The JSON document of a glTF file."""
    content = path.read_bytes()
    if path.suffix.lower() == ".glb":
        magic, _, announced, length, kind = struct.unpack_from("<4sIII4s", content)
        if magic != b"glTF" or kind != b"JSON" or not 20 + length <= announced <= len(content):
            raise InputError("it is no GLB file, or cut short.")
        content = content[20 : 20 + length]
    document = json.loads(content)
    if not isinstance(document, dict):
        raise InputError("there is no scene in it.")
    return document


def _check_scene(document: dict[str, Any]) -> None:
    """Raise an `InputError` if a glTF document asks for what its size does not warrant.

    The library that reads it would follow nodes that repeat each other, fill arrays of any size
    with zeros, and open any file that is named.
    """
    buffers, nodes = document.get("buffers", []), document.get("nodes", [])
    for uri in (buffer.get("uri", "data:") for buffer in buffers):
        name = unquote(str(uri))
        outside = (
            ":" in name or "\\" in name or Path(name).is_absolute() or ".." in Path(name).parts
        )
        if not name.startswith("data:") and outside:
            raise InputError(f"it takes data from '{name}', which is not beside it.")
    children = [child for node in nodes for child in node.get("children", [])]
    roots = [root for scene in document.get("scenes", []) for root in set(scene.get("nodes", []))]
    if len(set(children)) < len(children) or set(children) & set(roots):
        raise InputError("its nodes are no tree: one has two parents.")
    accessors = document.get("accessors", [])
    counts = [
        sum(
            int(accessors[primitive["attributes"]["POSITION"]]["count"])
            for primitive in mesh["primitives"]
            if "POSITION" in primitive["attributes"]
        )
        for mesh in document.get("meshes", [])
    ]
    total = sum(counts[node["mesh"]] for node in nodes if "mesh" in node)
    largest = max((int(accessor["count"]) for accessor in accessors), default=0)
    if max(total, largest) > _MOST_VERTICES:
        raise InputError(
            f"it has {max(total, largest)} vertices; expected at most {_MOST_VERTICES}."
        )


def _declared_counts(path: Path) -> tuple[int, int] | None:
    """Vertex and face count that the head of an OFF or PLY file announces."""
    suffix = path.suffix.lower()
    if suffix not in (".off", ".ply"):
        return None
    with path.open("rb") as file:
        head = file.read(65536).decode("latin-1")
    if suffix == ".ply":
        words = [line.split() for line in head.split("end_header")[0].splitlines()]
        form = next((word[1] for word in words if len(word) > 1 and word[0] == "format"), "none")
        if form not in ("ascii", "binary_little_endian", "binary_big_endian"):
            raise InputError(f"its format is '{form}', which PLY does not have.")
        counts = {word[1]: int(word[2]) for word in words if word[:1] == ["element"]}
        return counts.get("vertex", 0), counts.get("face", 0)
    lines = (line.split("#")[0] for line in head.splitlines())
    numbers = [word for line in lines for word in line.split()]
    if numbers[0].endswith("OFF") and len(numbers) > 2:
        return int(numbers[1]), int(numbers[2])
    return None


def _tell_triangulation(path: Path, before: int, after: int) -> None:
    if before != after:
        _log.warning("'%s': %d polygons were cut into %d triangles.", path, before, after)


def _read_xyz(path: Path) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
    points = np.loadtxt(path, ndmin=2, usecols=(0, 1, 2))
    if len(points) == 0:
        raise InputError("there are no points in it.")
    return points, np.zeros((0, 3), dtype=np.int64)


def _read_obj(path: Path) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
    """Read an OBJ file's positions and faces.

    Done here because the libraries split vertices along texture seams or drop those without a
    face, and then a map no longer fits the user's file.
    """
    text = path.read_text(encoding="utf-8", errors="replace").replace("\\\n", " ")
    lines = [line.split("#")[0] for line in text.splitlines()]
    positions = [line.split()[1:4] for line in lines if line.startswith(("v ", "v\t"))]
    if not positions:
        raise InputError("there are no vertices in it.")
    if any(len(position) < 3 for position in positions):
        raise InputError("a vertex has fewer than three coordinates; is the file cut short?")
    vertices = np.loadtxt(io.StringIO("\n".join(map(" ".join, positions))), ndmin=2)
    triangles: list[tuple[int, int, int]] = []
    face_count = 0
    seen = 0
    for line in lines:
        if line.startswith(("v ", "v\t")):
            seen += 1
        elif line.startswith(("f ", "f\t")):
            corners = [_obj_index(word, seen) for word in line.split()[1:]]
            face_count += 1
            triangles += [(corners[0], b, c) for b, c in pairwise(corners[1:])]
    _tell_triangulation(path, face_count, len(triangles))
    faces: IntArray = np.array(triangles, dtype=np.int64).reshape(-1, 3)
    return vertices, faces


def _obj_index(corner: str, seen: int) -> int:
    """Index from 0 of a corner such as `7/2/7`; negative ones count back from the last vertex."""
    index = int(corner.split("/")[0])
    if index == 0:
        raise InputError("faces count their vertices from 1; one has 0.")
    return index - 1 if index > 0 else seen + index
