"""Reading and writing meshes; vertex order and count are those of the file."""

from __future__ import annotations

import codecs
import gzip
import logging
import os
import tempfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from esd.common import InputError, existing_file, reason, whole_file
from esd.mesh.io.extra import read_3mf, read_by_meshio, read_freesurfer, read_gifti
from esd.mesh.io.gltf import read_gltf
from esd.mesh.io.obj import obj_text, read_obj
from esd.mesh.io.off import off_text, read_off
from esd.mesh.io.ply import ply_bytes, read_ply
from esd.mesh.io.points import read_pcd, read_xyz
from esd.mesh.io.polydata import is_legacy_polydata, read_legacy, read_vtp
from esd.mesh.io.stl import read_stl, stl_bytes
from esd.mesh.mesh import Mesh

_TEXTS = (".off", ".obj", ".gltf", ".xyz", ".vtk")
_LARGEST_FILE = 2**32
_LARGEST_UNPACKED = 2**30
_BLOCK = 2**20

_log = logging.getLogger(__name__)

_Arrays: TypeAlias = tuple[npt.NDArray[Any], npt.NDArray[Any], int]


def _obj(path: Path) -> _Arrays:
    content = read_obj(path)
    return content.vertices, content.faces, content.polygon_count


def _gltf(path: Path) -> _Arrays:
    scene = read_gltf(path)
    return scene.vertices, scene.faces, len(scene.faces)


def _vtk(path: Path) -> _Arrays:
    return read_legacy(path) if is_legacy_polydata(path) else _triangles(read_by_meshio)(path)


def _triangles(
    read: Callable[[Path], tuple[npt.NDArray[Any], npt.NDArray[Any]]],
) -> Callable[[Path], _Arrays]:
    """A reader of triangles that says how many polygons there were: as many."""

    def arrays(path: Path) -> _Arrays:
        vertices, faces = read(path)
        return vertices, faces, len(faces)

    return arrays


def _glb_bytes(mesh: Mesh) -> bytes:
    import trimesh

    return trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).export(file_type="glb")


def _points(read: Callable[[Path], npt.NDArray[Any]]) -> Callable[[Path], _Arrays]:
    """A reader of points that says that there are no faces."""
    return lambda path: (read(path), np.zeros((0, 3), dtype=np.int64), 0)


class Format(NamedTuple):
    """What reads a mesh file, and what makes the content of one, if anything does."""

    read: Callable[[Path], _Arrays]
    content: Callable[[Mesh], str | bytes] | None = None


_MESH_FORMATS: dict[str, Format] = {
    ".off": Format(read_off, off_text),
    ".obj": Format(_obj, obj_text),
    ".ply": Format(read_ply, ply_bytes),
    ".stl": Format(_triangles(read_stl), stl_bytes),
    ".glb": Format(_gltf, _glb_bytes),
    ".gltf": Format(_gltf),  # it would be scattered over several files
    ".vtk": Format(_vtk),
    ".vtp": Format(read_vtp),
    ".vtu": Format(_triangles(read_by_meshio)),
    ".msh": Format(_triangles(read_by_meshio)),
    ".3mf": Format(_triangles(read_3mf)),
    ".gii": Format(_triangles(read_gifti)),
    **dict.fromkeys(
        (".pial", ".white", ".inflated", ".sphere", ".orig", ".smoothwm"),
        Format(_triangles(read_freesurfer)),
    ),
}
_POINT_FORMATS: dict[str, Format] = {
    ".xyz": Format(_points(read_xyz)),
    ".pcd": Format(_points(read_pcd)),
}

FORMATS = tuple(_MESH_FORMATS)
"""Suffixes of the mesh files that are read, each also with `.gz` after it."""

WRITTEN_FORMATS = tuple(name for name, each in _MESH_FORMATS.items() if each.content)
"""Suffixes of the mesh files that are written."""

POINT_FORMATS = tuple(_POINT_FORMATS)
"""Suffixes of the files that hold points alone; `.ply` may, too."""


def read_mesh(path: str | os.PathLike[str]) -> Mesh:
    """The mesh in a file, its vertices in the order and number of the file.

    Polygons are cut into triangles, and the log says how many. STL files hold no shared vertices:
    corners at exactly one place become one vertex, in order of first appearance. The parts of a
    glTF scene are placed and joined.

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

    Coordinates that are not finite and indices beyond the last vertex are kept. m is zero for
    files of points: those of `POINT_FORMATS`, and PLY files that declare no faces.

    Parameters
    ----------
    path
        A file with one of the suffixes in `FORMATS` or `POINT_FORMATS`, or one of these with
        `.gz` after it. An XYZ file holds a point a line, its first three numbers.

    Raises
    ------
    InputError
        If there is no such file, or nothing of the kind in it, or it is cut short.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    is_packed = suffix == ".gz"
    if is_packed:
        suffix = Path(path.stem).suffix.lower()
    if suffix not in FORMATS + POINT_FORMATS:
        known = ", ".join(FORMATS + POINT_FORMATS)
        if path.is_dir():
            raise InputError(f"'{path}' is a folder; expected a file with one of {known}.")
        raise InputError(f"'{path}' is not a mesh file; expected one of {known}.")
    existing_file(path)
    if path.stat().st_size > _LARGEST_FILE:
        raise InputError(f"'{path}' is larger than 4 GiB; simplify the mesh first.")
    if suffix in _TEXTS:
        with path.open("rb") as file:
            if file.read(2) in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE):
                raise InputError(f"'{path}' is text in UTF-16; save it in UTF-8 or ASCII.")
    read = (_MESH_FORMATS | _POINT_FORMATS)[suffix].read
    try:
        vertices, faces, polygons = _unpacked(path, read) if is_packed else read(path)
        if len(faces) == 0 and suffix not in (*POINT_FORMATS, ".ply"):
            raise InputError("there are no faces in it that could be read.")
    except OSError as error:
        raise InputError(f"'{path}' cannot be read: {error.strerror or error}.") from error
    except InputError as error:
        raise InputError(f"'{path}': {error}") from error
    except Exception as error:  # whatever a parser stumbles over is bad input
        kind = suffix[1:].upper()
        faulty = isinstance(error, AttributeError | TypeError | KeyError | IndexError)
        why = "it is damaged, or of another format" if faulty else reason(error)
        raise InputError(f"'{path}' cannot be read as {kind}: {why}") from error
    if polygons != len(faces):
        cut = "1 polygon was" if polygons == 1 else f"{polygons} polygons were"
        _log.warning("'%s': %s cut into %d triangles.", path, cut, len(faces))
    return vertices, faces


def write_mesh(mesh: Mesh, path: str | os.PathLike[str]) -> None:
    """Write a mesh; the suffix of the path chooses the format, one of `WRITTEN_FORMATS`.

    Coordinates keep all their digits in OFF, OBJ and PLY, and seven in STL and glTF, whose numbers
    are 32 bits long. STL keeps neither the order nor the sharing of vertices.

    Raises
    ------
    InputError
        If the suffix is unknown or the file cannot be written.
    """
    path = check_mesh_path(path)
    content = _MESH_FORMATS[path.suffix.lower()].content
    assert content is not None  # of all in WRITTEN_FORMATS
    written = content(mesh)
    with whole_file(path) as temporary:
        temporary.write_bytes(written if isinstance(written, bytes) else written.encode())


def check_mesh_path(path: str | os.PathLike[str]) -> Path:
    """The path, if a mesh can be written to it; raises an `InputError` otherwise."""
    path = Path(path)
    if path.suffix.lower() not in WRITTEN_FORMATS:
        raise InputError(f"'{path}': expected a suffix among {', '.join(WRITTEN_FORMATS)}.")
    return path


def _unpacked(path: Path, read: Callable[[Path], _Arrays]) -> _Arrays:
    """What is in a file that gzip made, unpacked to a temporary one of bounded size."""
    with tempfile.TemporaryDirectory(prefix="esd-") as folder:
        unpacked = Path(folder) / path.stem
        size = 0
        try:
            with gzip.open(path) as source, unpacked.open("wb") as target:
                while block := source.read(_BLOCK):
                    size += len(block)
                    if size > _LARGEST_UNPACKED:
                        raise InputError("it unpacks to more than 1 GiB; unpack it yourself.")
                    target.write(block)
        except (gzip.BadGzipFile, EOFError, zlib.error) as error:
            raise InputError(f"it cannot be unpacked: {error}.") from error
        return read(unpacked)
