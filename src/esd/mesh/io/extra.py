"""Formats of the fields, read by meshio, nibabel and trimesh, the extra `formats`."""

from __future__ import annotations

import contextlib
import importlib
import io
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from esd.common import InputError, install_hint
from esd.mesh.objects import object_arrays

# by suffix: without it meshio tries others, too, of which that of ANSYS reads some files for ever
_MESHIO = {".vtk": "vtk", ".vtu": "vtu", ".msh": "gmsh"}
_LARGEST = 2**30  # bytes that a compressed file may unpack to


def read_by_meshio(path: Path) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
    """Triangles and quadrilaterals of a VTK, VTU or Gmsh file."""
    meshio = _module("meshio")
    try:
        # it prints what is wrong, and exits
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            content = meshio.read(path, file_format=_MESHIO[path.suffix.lower()])
    except SystemExit as error:
        raise InputError("meshio cannot read it; convert it to another format.") from error
    return object_arrays(content)


def read_gifti(path: Path) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
    """The surface in a GIFTI file."""
    image = _module("nibabel").load(path)
    vertices, faces = image.agg_data("pointset"), image.agg_data("triangle")
    if len(vertices) == 0 or len(faces) == 0:
        raise InputError("it holds values and no surface; give the surface file.")
    return np.asarray(vertices, dtype=float), np.asarray(faces)


def read_freesurfer(path: Path) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
    """The surface in a file of FreeSurfer, such as `lh.pial`."""
    with path.open("rb") as file:
        if file.read(3) not in (b"\xff\xff\xfe", b"\xff\xff\xff"):
            raise InputError("it is no surface of FreeSurfer.")
    vertices, faces = _module("nibabel.freesurfer").read_geometry(str(path))[:2]
    return np.asarray(vertices, dtype=float), np.asarray(faces)


def read_3mf(path: Path) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
    """The parts of a 3MF file, placed and joined."""
    for name in ("lxml", "networkx"):  # trimesh needs them for this format
        _module(name)
    import trimesh

    with zipfile.ZipFile(path) as archive:
        if sum(entry.file_size for entry in archive.infolist()) > _LARGEST:
            raise InputError("it unpacks to more than 1 GiB; simplify the mesh first.")
    mesh = trimesh.load_scene(path, process=False).to_mesh()
    return np.asarray(mesh.vertices), np.asarray(mesh.faces)


def _module(name: str) -> Any:
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        raise InputError(f"this format needs more packages: {install_hint('formats')}.") from error
