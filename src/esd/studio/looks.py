"""What colours the surface of a shape: its own texture, or colours of its vertices."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
import numpy.typing as npt

from esd.common import InputError
from esd.matching.along import transfer, transferred_texture
from esd.matching.correspondence import Correspondence
from esd.mesh.io.attributes import read_vertex_colours, write_coloured
from esd.mesh.io.meshes import read_mesh
from esd.mesh.io.textures import TEXTURE_FORMATS, Texture, read_texture, write_textured
from esd.mesh.mesh import Mesh

Kind = Literal["texture", "colours", ""]

_COLOURED = (".ply", ".glb", ".gltf", ".obj")


def look(path: Path) -> tuple[Kind, npt.NDArray[np.uint8]]:
    """What colours a shape in a file, and the red, green and blue of its vertices, (n, 3).

    Of a texture these are sampled at the vertices. The array is empty where the file has neither
    a texture that can be read nor colours.
    """
    suffix = path.suffix.lower()
    if suffix in TEXTURE_FORMATS:
        try:
            return "texture", _sampled(read_texture(path), read_mesh(path))
        except InputError:
            pass  # it has none
    if suffix in _COLOURED:
        try:
            return "colours", read_vertex_colours(path)[:, :3]
        except InputError:
            pass
    return "", np.zeros((0, 3), dtype=np.uint8)


def _sampled(texture: Texture, mesh: Mesh) -> npt.NDArray[np.uint8]:
    """The colour of a texture at each vertex; where several faces disagree, that of the last."""
    pixels = np.asarray(texture.image.convert("RGB"))
    height, width = pixels.shape[:2]
    # coordinates begin at the lower left and repeat beyond 1; rows of pixels begin at the top
    across, up = np.moveaxis(texture.coordinates - np.floor(texture.coordinates), 2, 0)
    column = np.minimum((across * width).astype(int), width - 1)
    row = np.minimum(((1 - up) * height).astype(int), height - 1)
    colours = np.full((len(mesh.vertices), 3), 160, dtype=np.uint8)
    colours[mesh.faces] = pixels[row, column]
    return colours


def write_carried_look(
    source: Path, target: Mesh, match: Correspondence, kind: Kind, path: Path
) -> None:
    """Write the target with the texture or the colours of the source, carried along a map.

    Raises
    ------
    InputError
        If the source has none, part of the target is out of reach of a texture, or the suffix is
        of another format.
    """
    if kind == "texture":
        texture = read_texture(source)
        coordinates = transferred_texture(texture.coordinates, source, target, match)
        write_textured(target, replace(texture, coordinates=coordinates), path)
    elif kind == "colours":
        colours = transfer(read_vertex_colours(source), source, target, match, kind="values")
        write_coloured(target, np.round(np.nan_to_num(colours)).astype(np.uint8), path)
    else:
        raise InputError("The source has neither a texture nor colours of its vertices.")
