"""What meshes carry besides their surface: attributes of vertices, colours and textures."""

from __future__ import annotations

import base64
import os
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np
import numpy.typing as npt

from esd.common import FloatArray, InputError, IntArray, whole_file
from esd.mesh.io.meshes import read_mesh
from esd.mesh.mesh import Mesh, PointCloud

ATTRIBUTE_FORMATS = (".ply", ".vtp")
"""Suffixes of the files in which vertices have attributes."""

TEXTURE_FORMATS = (".obj", ".glb")
"""Suffixes of the files of meshes with a texture."""

_VTK_TYPES = {"float64": "Float64", "float32": "Float32", "int64": "Int64", "int32": "Int32"}


@dataclass(frozen=True, slots=True, eq=False)
class Texture:
    """An image on a mesh.

    Parameters
    ----------
    coordinates : (m, 3, 2)
        Where the corners of each face lie on the image, from (0, 0) at the lower left to (1, 1).
    image
        A `PIL.Image.Image`.
    """

    coordinates: FloatArray
    image: Any


def write_with_attributes(
    mesh: Mesh | PointCloud,
    attributes: Mapping[str, npt.NDArray[Any]],
    path: str | os.PathLike[str],
) -> None:
    """Write a shape with attributes of its vertices, (n,) numbers each, as PLY or VTP.

    MeshLab and Blender read PLY, ParaView reads VTP. In PLY integers and coordinates have 32 bits.

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
        narrow = {k: v.astype("i4") if v.dtype.kind == "i" else v for k, v in attributes.items()}
        content = _surface(mesh, vertex_attributes=narrow).export(file_type="ply")
    with whole_file(path) as temporary:
        temporary.write_bytes(content)


def read_vertex_colours(path: str | os.PathLike[str]) -> npt.NDArray[np.uint8]:
    """Red, green, blue and opacity of each vertex in a mesh file, (n, 4) from 0 to 255.

    Raises
    ------
    InputError
        If the file has none.
    """
    import trimesh

    count = len(read_mesh(path).vertices)
    visual = trimesh.load_mesh(path, process=False).visual
    colours = np.asarray(getattr(visual, "vertex_colors", ()))
    if getattr(visual, "kind", None) != "vertex" or colours.shape != (count, 4):
        raise InputError(f"'{path}' has no colours of its vertices.")
    return colours.astype(np.uint8)


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


def read_texture(path: str | os.PathLike[str]) -> Texture:
    """The texture of a mesh file, its faces in the order of `read_mesh`.

    An OBJ file names its image in the material file that it names; a GLB file holds it. One image
    is read.

    Raises
    ------
    InputError
        If the file is of another format, or has no texture coordinates or no image.
    """
    path = Path(path)
    if path.suffix.lower() not in TEXTURE_FORMATS:
        raise InputError(f"'{path}': textures are read from {', '.join(TEXTURE_FORMATS)}.")
    mesh = read_mesh(path)
    texture = _obj_texture(path) if path.suffix.lower() == ".obj" else _glb_texture(path)
    if texture.coordinates.shape != (len(mesh.faces), 3, 2):
        raise InputError(f"'{path}' has no texture coordinates at some corners of its faces.")
    return texture


def write_textured(mesh: Mesh, texture: Texture, path: str | os.PathLike[str]) -> None:
    """Write a mesh with its texture: OBJ with `.mtl` and `.png` of the same name, or GLB.

    OBJ keeps the vertices in order and number; GLB has a vertex more for each place on the image.

    Raises
    ------
    InputError
        If the suffix is another or a file cannot be written.
    """
    path = Path(path)
    if path.suffix.lower() not in TEXTURE_FORMATS:
        raise InputError(f"'{path}': textures are written to {', '.join(TEXTURE_FORMATS)}.")
    places, at = np.unique(texture.coordinates.reshape(-1, 2), axis=0, return_inverse=True)
    at = at.reshape(-1, 3)
    if path.suffix.lower() == ".glb":
        from trimesh.visual import TextureVisuals

        pairs, face = np.unique(
            np.stack([mesh.faces, at], axis=2).reshape(-1, 2), axis=0, return_inverse=True
        )
        split = Mesh(mesh.vertices[pairs[:, 0]], face.reshape(-1, 3))
        visual = TextureVisuals(uv=places[pairs[:, 1]], image=texture.image)
        content = _surface(split, visual=visual).export(file_type="glb")
        with whole_file(path) as temporary:
            temporary.write_bytes(content)
        return
    stem = path.stem
    lines = [f"mtllib {stem}.mtl", "usemtl texture"]
    lines += ["v " + " ".join(map(repr, vertex)) for vertex in mesh.vertices.tolist()]
    lines += [f"vt {u:.9g} {v:.9g}" for u, v in places]
    corners = zip((mesh.faces + 1).tolist(), (at + 1).tolist(), strict=True)
    lines += ["f " + " ".join(f"{v}/{t}" for v, t in zip(*face, strict=True)) for face in corners]
    with whole_file(path.with_suffix(".png")) as temporary:
        texture.image.save(temporary)
    with whole_file(path.with_suffix(".mtl")) as temporary:
        temporary.write_text(f"newmtl texture\nKd 1 1 1\nmap_Kd {stem}.png\n", encoding="utf-8")
    with whole_file(path) as temporary:
        temporary.write_text("\n".join([*lines, ""]), encoding="utf-8")


def _surface(mesh: Mesh | PointCloud, **options: Any) -> Any:
    import trimesh

    return trimesh.Trimesh(mesh.vertices, _faces(mesh), process=False, **options)


def _obj_texture(path: Path) -> Texture:
    from PIL import Image

    text = path.read_text(encoding="utf-8", errors="replace").replace("\\\n", " ")
    lines = [line.split("#")[0].split() for line in text.splitlines()]
    places = np.array([[float(x) for x in w[1:3]] for w in lines if w[:1] == ["vt"]])
    corners: list[tuple[int, int, int]] = []
    try:
        for words in lines:
            if words[:1] == ["f"]:
                at = [int(corner.split("/")[1]) for corner in words[1:]]
                corners += [(at[0], b, c) for b, c in pairwise(at[1:])]
        index: IntArray = np.array(corners)
        coordinates = places[np.where(index > 0, index - 1, index)]
    except (IndexError, ValueError) as error:
        raise InputError(f"'{path}' has no texture coordinates at some corners.") from error
    materials = [path.parent / " ".join(w[1:]) for w in lines if w[:1] == ["mtllib"]]
    images = [
        material.parent / line.split()[-1]
        for material in materials
        if material.is_file()
        for line in material.read_text(encoding="utf-8", errors="replace").splitlines()
        if line.split()[:1] == ["map_Kd"]
    ]
    if not images or not images[0].is_file():
        where = f"'{images[0]}' is missing" if images else "its material names none"
        raise InputError(f"'{path}' has no image: {where}.")
    try:
        with Image.open(images[0]) as image:
            return Texture(coordinates, image.copy())
    except (OSError, Image.DecompressionBombError) as error:
        raise InputError(f"'{images[0]}' cannot be read as an image: {error}.") from error


def _glb_texture(path: Path) -> Texture:
    import trimesh

    loaded = trimesh.load_mesh(path, process=False)
    places = getattr(loaded.visual, "uv", None)
    material = getattr(loaded.visual, "material", None)
    image = getattr(material, "baseColorTexture", None)
    if places is None or image is None:
        raise InputError(f"'{path}' has no texture.")
    return Texture(np.asarray(places)[np.asarray(loaded.faces)], image)


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
