"""What meshes carry at their vertices: attributes and colours."""

from __future__ import annotations

import base64
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np
import numpy.typing as npt

from esd.common import InputError, IntArray, whole_file
from esd.mesh.io.gltf import read_gltf
from esd.mesh.io.meshes import read_mesh, write_mesh
from esd.mesh.io.obj import obj_text_like, read_obj
from esd.mesh.io.ply import ply_bytes, ply_elements
from esd.mesh.io.textures import (
    TEXTURE_FORMATS,
    Texture,
    read_texture,
    write_obj_like,
    write_textured,
)
from esd.mesh.mesh import Mesh, PointCloud

ATTRIBUTE_FORMATS = (".ply", ".vtp")
"""Suffixes of the files in which vertices have attributes."""

_STOPS = (0.0, 0.25, 0.5, 0.75, 1.0)
_COLOURS = np.array(  # of matplotlib's viridis at these stops
    [[68, 1, 84], [59, 82, 139], [33, 145, 140], [94, 201, 98], [253, 231, 37]]
)
_OWN = ("x", "y", "z", "nx", "ny", "nz")  # of a PLY file, which another mesh has otherwise
_VTK_TYPES = {"float64": "Float64", "float32": "Float32", "int64": "Int64", "int32": "Int32"}


def write_with_attributes(
    mesh: Mesh | PointCloud,
    attributes: Mapping[str, npt.NDArray[Any]],
    path: str | os.PathLike[str],
) -> None:
    """Write a shape with attributes of its vertices, (n,) numbers each, as PLY or VTP.

    MeshLab and Blender read PLY, ParaView reads VTP. A PLY file also has the confidence, or else
    the first attribute, as `quality`, which MeshLab reads, and as colours from dark blue to yellow,
    which all programs show. Its attributes have 32 bits, which is what they read.

    Raises
    ------
    InputError
        If the suffix is another, an attribute has another shape, or the file cannot be written.
    """
    path = Path(path)
    if path.suffix.lower() not in ATTRIBUTE_FORMATS:
        raise InputError(f"'{path}': expected a suffix among {', '.join(ATTRIBUTE_FORMATS)}.")
    for name, values in attributes.items():
        if values.shape != (len(mesh.vertices),):
            raise InputError(
                f"The attribute '{name}' must have shape ({len(mesh.vertices)},); "
                f"got {values.shape}."
            )
    if path.suffix.lower() == ".vtp":
        content = _vtp(mesh, attributes).encode()
    else:
        content = ply_bytes(mesh, _ply_columns(attributes))
    with whole_file(path) as temporary:
        temporary.write_bytes(content)


def read_vertex_colours(path: str | os.PathLike[str]) -> npt.NDArray[np.uint8]:
    """Red, green, blue and opacity of each vertex in a mesh file, (n, 4) from 0 to 255.

    Raises
    ------
    InputError
        If the file has none.
    """
    path = Path(path)
    count = len(read_mesh(path).vertices)
    suffix = path.suffix.lower()
    colours: npt.NDArray[Any] = np.zeros((0, 4))
    if suffix == ".ply":
        vertex = ply_elements(path)["vertex"]
        columns = [vertex.get(name) for name in ("red", "green", "blue", "alpha")]
        kept = [column for column in columns if isinstance(column, np.ndarray)]
        if len(kept) >= 3:
            opaque = 1.0 if kept[0].dtype.kind == "f" else 255
            kept += [np.full(count, opaque)] * (4 - len(kept))
            colours = np.stack(kept, axis=1) * (255 if opaque == 1.0 else 1)
    elif suffix in (".glb", ".gltf"):
        colours = 255 * read_gltf(path).colours
    elif suffix == ".obj":
        colours = read_obj(path).colours
        scale = 255 if len(colours) and np.nanmax(colours) <= 1 else 1  # most write 0 to 1
        colours = np.column_stack([scale * colours, np.full(len(colours), 255)])
    if colours.shape != (count, 4) or not np.isfinite(colours).all():
        raise InputError(f"'{path}' has no colours of its vertices.")
    return np.clip(np.round(colours), 0, 255).astype(np.uint8)


def write_coloured(
    mesh: Mesh, colours: npt.NDArray[np.uint8], path: str | os.PathLike[str]
) -> None:
    """Write a mesh with colours of its vertices, (n, 4) from 0 to 255, as PLY or GLB.

    Raises
    ------
    InputError
        If the suffix is another or the file cannot be written.
    """
    path = Path(path)
    if path.suffix.lower() not in (".ply", ".glb"):
        raise InputError(f"'{path}': colours are written to .ply or .glb.")
    content = _surface(mesh, vertex_colors=colours).export(file_type=path.suffix.lower()[1:])
    with whole_file(path) as temporary:
        temporary.write_bytes(content)


def write_mesh_like(
    mesh: Mesh, path: str | os.PathLike[str], *, original: str | os.PathLike[str]
) -> None:
    """Write a mesh with the texture, groups or attributes of a file of equal connectivity.

    Textures go from OBJ and GLB files to such; polygons, groups, materials and texture coordinates
    from OBJ to OBJ, unless there are several images, which are put together into one; numbers at
    vertices and faces from PLY to PLY; between other formats nothing goes along. Normals are left
    out: they are no longer those of the mesh.

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    path, original = Path(path), Path(original)
    suffixes = original.suffix.lower(), path.suffix.lower()
    if suffixes == (".obj", ".obj") and write_obj_like(mesh, path, original=original):
        return
    if all(suffix in TEXTURE_FORMATS for suffix in suffixes):
        texture = _texture(original)
        if texture is not None and len(texture.coordinates) == len(mesh.faces):
            write_textured(mesh, texture, path)
            return
    if suffixes == (".obj", ".obj"):
        with whole_file(path) as temporary:
            temporary.write_text(obj_text_like(mesh, original), encoding="utf-8")
    elif suffixes == (".ply", ".ply"):
        elements = ply_elements(original)
        kept, of_faces = (
            {
                name: values
                for name, values in elements.get(element, {}).items()
                if name not in _OWN and not isinstance(values, tuple) and len(values) == count
            }
            # polygons have more triangles than numbers
            for element, count in (("vertex", len(mesh.vertices)), ("face", len(mesh.faces)))
        )
        with whole_file(path) as temporary:
            temporary.write_bytes(ply_bytes(mesh, kept, of_faces))
    else:
        write_mesh(mesh, path)


def _texture(path: Path) -> Texture | None:
    try:
        return read_texture(path)
    except InputError:  # it has none
        return None


def _ply_columns(attributes: Mapping[str, npt.NDArray[Any]]) -> dict[str, npt.NDArray[Any]]:
    """Columns of a PLY file: attributes of 32 bits, one of them as quality and as colours."""
    columns = {
        name.replace(" ", "_"): values.astype("<i4" if values.dtype.kind in "iu" else "<f4")
        for name, values in attributes.items()
    }
    shown = attributes.get("confidence", next(iter(attributes.values()), None))
    if shown is None:
        return columns
    values = np.asarray(shown, dtype=float)
    finite = np.isfinite(values)
    low, high = (values[finite].min(), values[finite].max()) if finite.any() else (0.0, 0.0)
    share = np.clip((np.where(finite, values, low) - low) / (high - low or 1.0), 0, 1)
    colours = [np.interp(share, _STOPS, column) for column in _COLOURS.T]
    names = ("red", "green", "blue")
    return {
        **{k: np.round(c).astype("u1") for k, c in zip(names, colours, strict=True)},
        "quality": values.astype("<f4"),
        **columns,
    }


def _surface(mesh: Mesh | PointCloud, **options: Any) -> Any:
    import trimesh

    return trimesh.Trimesh(mesh.vertices, _faces(mesh), process=False, **options)


def _faces(mesh: Mesh | PointCloud) -> IntArray:
    """The faces, (m, 3); none of a point cloud."""
    return mesh.faces if isinstance(mesh, Mesh) else np.zeros((0, 3), dtype=np.int64)


def _vtp(mesh: Mesh | PointCloud, attributes: Mapping[str, npt.NDArray[Any]]) -> str:
    """A VTK XML file of polygons, its arrays in base64 after their length in bytes."""
    count = len(_faces(mesh))

    def array(name: str, values: npt.NDArray[Any], components: int = 1) -> str:
        values = np.ascontiguousarray(values, dtype=values.dtype.newbyteorder("<"))
        length = np.array([values.nbytes], dtype="<u8").tobytes()
        data = base64.b64encode(length + values.tobytes()).decode("ascii")
        return (
            f'<DataArray type="{_VTK_TYPES[values.dtype.name]}" Name={quoteattr(name)} '
            f'NumberOfComponents="{components}" format="binary">{data}</DataArray>'
        )

    return "\n".join(
        [
            '<?xml version="1.0"?>',
            '<VTKFile type="PolyData" version="1.0" byte_order="LittleEndian" '
            'header_type="UInt64"><PolyData>',
            f'<Piece NumberOfPoints="{len(mesh.vertices)}" NumberOfPolys="{count}">',
            "<Points>" + array("Points", mesh.vertices, 3) + "</Points>",
            "<Polys>" + array("connectivity", _faces(mesh).ravel()),
            array("offsets", 3 * np.arange(1, count + 1)) + "</Polys>",
            "<PointData>",
            *(array(name, values) for name, values in attributes.items()),
            "</PointData></Piece></PolyData></VTKFile>",
            "",
        ]
    )
