"""Images on meshes: OBJ with its materials, and GLB."""

from __future__ import annotations

import io
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from esd.common import FloatArray, InputError, IntArray, install_hint, is_file, whole_file
from esd.mesh.io.gltf import gltf_image, read_gltf
from esd.mesh.io.meshes import read_mesh
from esd.mesh.io.obj import ObjFile, obj_text_like, read_obj
from esd.mesh.mesh import Mesh

TEXTURE_FORMATS = (".obj", ".glb")
"""Suffixes of the files of meshes with a texture."""

_WIDEST, _HIGHEST = 2**14, 2**13  # pixels of an image that is put together of several
_OUTSIDE = 0.01  # of an image, by which coordinates may be off it through rounding
_MAPS = ("map_", "bump", "norm", "disp", "decal", "refl")  # begin lines that name images
_MOST_TILES = 64  # repetitions of an image over one face
_OPTIONS = {"-blendu": 1, "-blendv": 1, "-bm": 1, "-boost": 1, "-cc": 1, "-clamp": 1}
_OPTIONS |= {"-imfchan": 1, "-mm": 2, "-texres": 1, "-type": 1, "-o": 3, "-s": 3, "-t": 3}


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


def read_texture(path: str | os.PathLike[str]) -> Texture:
    """The texture of a mesh file, its faces in the order of `read_mesh`.

    An OBJ file names its image in the material file that it names; a GLB file holds it. Images of
    other colours than red, green and blue, such as CMYK, are converted. Several images are put side
    by side into one, those that are repeated over a face as often as needed.

    Raises
    ------
    InputError
        If the file is of another format, has no texture coordinates or no image at some faces,
        or several images that are repeated many times over one face, or Pillow is not installed.
    """
    path = Path(path)
    if path.suffix.lower() not in TEXTURE_FORMATS:
        raise InputError(f"'{path}': textures are read from {', '.join(TEXTURE_FORMATS)}.")
    read_mesh(path)  # says what is wrong with the mesh, if anything
    coordinates, contents, number = (
        _obj_texture(read_obj(path), path) if path.suffix.lower() == ".obj" else _glb_texture(path)
    )
    if np.isnan(coordinates).any():
        raise InputError(f"'{path}' has no texture coordinates at some corners of its faces.")
    images = [_image(*content) for content in contents]
    if len(images) == 1:
        return Texture(coordinates, images[0])
    moved, tiles = _tiled(coordinates)
    if tiles.prod() > _MOST_TILES:
        raise InputError(
            f"'{path}' repeats images {tiles[0]} × {tiles[1]} times over one face; expected at "
            f"most {_MOST_TILES} times in all. Bake them into one."
        )
    return _side_by_side(moved, images, number, tiles)


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
        import trimesh
        from trimesh.visual import TextureVisuals

        # a vertex for each pair of a vertex and a place on the image
        pairs, face = np.unique(
            np.stack([mesh.faces, at], axis=2).reshape(-1, 2), axis=0, return_inverse=True
        )
        visual = TextureVisuals(uv=places[pairs[:, 1]], image=texture.image)
        content = trimesh.Trimesh(
            mesh.vertices[pairs[:, 0]], face.reshape(-1, 3), process=False, visual=visual
        ).export(file_type="glb")
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


def write_obj_like(mesh: Mesh, path: Path, *, original: Path) -> bool:
    """Write an OBJ file with all that another one of equal connectivity has; whether it was.

    Polygons, groups, materials and texture coordinates stay; `.mtl` and `.png` of the same name as
    the new file are its materials and image. Nothing is written if the other one has no texture, or
    several images.
    """
    try:
        content = read_obj(original)
        coordinates, contents, _ = _obj_texture(content, original)
        if len(contents) > 1 or np.isnan(coordinates).any():
            return False
        image = _image(*contents[0])
    except InputError:  # it has no texture
        return False
    materials, text = path.with_suffix(".mtl"), _materials(content, original, f"{path.stem}.png")
    with whole_file(path.with_suffix(".png")) as temporary:
        image.save(temporary)
    with whole_file(materials) as temporary:
        temporary.write_text(text, encoding="utf-8")
    with whole_file(path) as temporary:
        whole = obj_text_like(mesh, original, library=materials.name)
        temporary.write_text(whole, encoding="utf-8")
    return True


def _materials(content: ObjFile, path: Path, image: str) -> str:
    """The material files of an OBJ file in one, with another image; maps of other kinds left out.

    Their files are not beside the new one.
    """
    lines = []
    for library in content.libraries:
        file = _beside(path, library)
        read = file.read_text(encoding="utf-8-sig", errors="replace") if is_file(file) else ""
        for line in read.splitlines():
            kind = line.split()[0] if line.split() else ""
            if kind == "map_Kd":
                lines.append(f"map_Kd {image}")
            elif not kind.lower().startswith(_MAPS):
                lines.append(line)
    return "\n".join([*lines, ""])


def _image(content: bytes, name: str) -> Any:
    try:
        from PIL import Image
    except ModuleNotFoundError as error:
        raise InputError(f"'{name}' needs Pillow: {install_hint('viz')}.") from error
    try:
        with Image.open(io.BytesIO(content)) as image:
            kept = image.mode in ("RGB", "RGBA", "L", "LA", "P")
            return image.copy() if kept else image.convert("RGB")
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
        raise InputError(f"'{name}' cannot be read as an image: {error}.") from error


def _tiled(coordinates: FloatArray) -> tuple[FloatArray, IntArray]:
    """Coordinates moved by whole images, each face to the first, and how many any reaches, (2,).

    Renderers repeat an image in all directions; a face that lies on one repetition of it looks the
    same on the first.
    """
    moved = coordinates - np.floor(coordinates.min(axis=1, keepdims=True) + _OUTSIDE)
    tiles = np.maximum(np.ceil(moved.max(axis=(0, 1)) - _OUTSIDE), 1).astype(np.int64)
    return np.clip(moved, 0, tiles), tiles


def _side_by_side(
    coordinates: FloatArray, images: list[Any], number: IntArray, tiles: IntArray
) -> Texture:
    """One texture of several images, each repeated.

    Parameters
    ----------
    coordinates : (m, 3, 2)
        In units of an image, from zero to `tiles`.
    number : (m,)
        The image on each face.
    tiles : (2,)
        How often each image is repeated, across and up.
    """
    from PIL import Image

    across, up = tiles.tolist()
    width = min(max(image.width for image in images), _WIDEST // (len(images) * across))
    height = min(max(image.height for image in images), _HIGHEST // up)
    whole = Image.new("RGBA", (width * len(images) * across, height * up))
    for place, image in enumerate(images):
        tile = image.convert("RGBA").resize((width, height))
        for i in range(across):
            for j in range(up):
                whole.paste(tile, ((place * across + i) * width, j * height))
    # image k takes the columns of pixels from k times its width on, all repetitions included
    u = (coordinates[:, :, 0] / across + number[:, None]) / len(images)
    return Texture(np.stack([u, coordinates[:, :, 1] / up], axis=2), whole)


_Found: TypeAlias = tuple[FloatArray, list[tuple[bytes, str]], IntArray]
"""Coordinates (m, 3, 2), content and name of each image, and which is on each face, (m,)."""


def _obj_texture(content: ObjFile, path: Path) -> _Found:
    index = content.texture_faces
    if index.min() < 0 or index.max() >= len(content.coordinates):
        raise InputError(f"'{path}' has no texture coordinates at some corners.")
    images = _material_images(content, path)
    if not images:
        raise InputError(f"'{path}' has no image: its material names none.")
    numbers = np.unique(content.material)
    if len(numbers) > 1 and numbers[0] < 0:
        raise InputError(f"'{path}' has faces without a material; give them one.")
    # a file without usemtl has its one material everywhere
    used = [images.get(content.materials[k]) if k >= 0 else None for k in numbers]
    if numbers[0] < 0 and len(set(images.values())) == 1:
        used = [next(iter(images.values()))]
    found = sorted({image for image in used if image})
    if None in used:
        raise InputError(f"'{path}' has no image at some faces: their material names none.")
    for image in found:
        if not is_file(image):
            raise InputError(f"'{path}' has no image: '{image}' is missing.")
    place = np.array([found.index(image) for image in used if image])
    number = place[np.searchsorted(numbers, content.material)]
    contents = [(image.read_bytes(), str(image)) for image in found]
    return content.coordinates[index], contents, number


def _material_images(content: ObjFile, path: Path) -> dict[str, Path]:
    """The image of each material, by its name."""
    images: dict[str, Path] = {}
    for library in content.libraries:
        file = _beside(path, library)
        if not is_file(file):
            continue
        name = ""
        for line in file.read_text(encoding="utf-8-sig", errors="replace").splitlines():
            words = line.split()
            if words[:1] == ["newmtl"]:
                name = " ".join(words[1:])
            elif words[:1] == ["map_Kd"]:
                rest = words[1:]
                while rest and rest[0] in _OPTIONS:
                    rest = rest[1 + _OPTIONS[rest[0]] :]
                images[name] = _beside(file, " ".join(rest))
    return images


def _beside(file: Path, name: str) -> Path:
    """A file that another one names; programs for Windows write backslashes."""
    found = file.parent / name
    return found if is_file(found) else file.parent / name.replace("\\", "/")


def _glb_texture(path: Path) -> _Found:
    scene = read_gltf(path)
    numbers = np.unique(scene.material)
    sources = [_base_texture(scene.document, number) for number in numbers]
    if set(sources) == {None}:
        raise InputError(f"'{path}' has no texture.")
    found = sorted({source for source in sources if source is not None})
    if None in sources:
        raise InputError(f"'{path}' has an image on some of its faces only; give all one.")
    try:
        contents = [(gltf_image(scene, source, path), str(path)) for source in found]
    except (InputError, KeyError, IndexError, TypeError) as error:
        raise InputError(f"'{path}' has an image that cannot be read: {error}") from error
    place = np.array([found.index(source) for source in sources if source is not None])
    number = place[np.searchsorted(numbers, scene.material)]
    return scene.coordinates[scene.faces], contents, number


def _base_texture(document: dict[str, Any], material: int) -> int | None:
    """The number of the image that colours a material; None if there is none."""
    try:
        look = document["materials"][material] if material >= 0 else {}
        texture = look.get("pbrMetallicRoughness", {}).get("baseColorTexture")
        if texture is None:
            return None
        is_moved = "KHR_texture_transform" in texture.get("extensions", {})
        if texture.get("texCoord", 0) != 0 or is_moved:
            raise InputError("its texture is moved or has other coordinates; bake it.")
        return int(document["textures"][texture["index"]]["source"])
    except (KeyError, IndexError, TypeError, AttributeError) as error:
        raise InputError(f"its material has no image that can be read: {error}.") from error
