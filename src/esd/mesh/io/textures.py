"""Images on meshes: OBJ with its materials, and GLB."""

from __future__ import annotations

import io
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from esd.common import FloatArray, InputError, install_hint, is_file, whole_file
from esd.mesh.io.gltf import gltf_image, read_gltf
from esd.mesh.io.meshes import read_mesh
from esd.mesh.io.obj import ObjFile, read_obj
from esd.mesh.mesh import Mesh

TEXTURE_FORMATS = (".obj", ".glb")
"""Suffixes of the files of meshes with a texture."""

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
    other colours than red, green and blue, such as CMYK, are converted.

    Raises
    ------
    InputError
        If the file is of another format, has no texture coordinates or no image, or several
        images, or Pillow is not installed.
    """
    path = Path(path)
    if path.suffix.lower() not in TEXTURE_FORMATS:
        raise InputError(f"'{path}': textures are read from {', '.join(TEXTURE_FORMATS)}.")
    read_mesh(path)  # says what is wrong with the mesh, if anything
    coordinates, image, name = (
        _obj_texture(path) if path.suffix.lower() == ".obj" else _glb_texture(path)
    )
    if np.isnan(coordinates).any():
        raise InputError(f"'{path}' has no texture coordinates at some corners of its faces.")
    return Texture(coordinates, _image(image, name))


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


def _obj_texture(path: Path) -> tuple[FloatArray, bytes, str]:
    """Coordinates (m, 3, 2), the content of the image, and its name."""
    content = read_obj(path)
    index = content.texture_faces
    if index.min() < 0 or index.max() >= len(content.coordinates):
        raise InputError(f"'{path}' has no texture coordinates at some corners.")
    images = _material_images(content, path)
    if not images:
        raise InputError(f"'{path}' has no image: its material names none.")
    used = {content.materials[number] for number in np.unique(content.material) if number >= 0}
    # a file without usemtl has its one material everywhere
    names = {images.get(name) for name in used} if used else set(images.values())
    if len(names) != 1:
        listed = ", ".join(sorted(f"'{name.name}'" if name else "none" for name in names))
        raise InputError(
            f"'{path}' has several images ({listed}); expected one for all faces. Bake them "
            "into one image."
        )
    if used and (content.material < 0).any():
        raise InputError(f"'{path}' has faces without a material; give them one.")
    (image,) = names
    if image is None:
        raise InputError(f"'{path}' has no image: its material names none.")
    if not is_file(image):
        raise InputError(f"'{path}' has no image: '{image}' is missing.")
    return content.coordinates[index], image.read_bytes(), str(image)


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


def _glb_texture(path: Path) -> tuple[FloatArray, bytes, str]:
    """Coordinates (m, 3, 2), the content of the image, and its name."""
    scene = read_gltf(path)
    sources = {_base_texture(scene.document, number) for number in np.unique(scene.material)}
    if sources == {None}:
        raise InputError(f"'{path}' has no texture.")
    if len(sources) > 1:
        raise InputError(
            f"'{path}' has several images, or faces without one; expected one for all faces. "
            "Bake them into one image."
        )
    (source,) = sources
    try:
        content = gltf_image(scene, source or 0, path)
    except (InputError, KeyError, IndexError, TypeError) as error:
        raise InputError(f"'{path}' has an image that cannot be read: {error}") from error
    return scene.coordinates[scene.faces], content, str(path)


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
