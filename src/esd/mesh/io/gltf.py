"""glTF 2.0, text and binary: the triangles of a scene, with their places on images."""

from __future__ import annotations

import base64
import binascii
import json
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import unquote, unquote_to_bytes

import numpy as np
import numpy.typing as npt

from esd.common import FloatArray, InputError, IntArray, is_file

_MOST_VERTICES = 5 * 10**7  # of a scene with all its instances
_COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
_TRIANGLES, _STRIP, _FAN = 4, 5, 6
_KNOWN = ("KHR_mesh_quantization", "KHR_materials_", "KHR_texture_", "EXT_texture_", "KHR_lights_")
_COMPRESSED = ("KHR_draco_mesh_compression", "EXT_meshopt_compression")


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """The triangles of a glTF file.

    Parameters
    ----------
    vertices : (n, 3)
    faces : (m, 3)
    coordinates : (n, 2)
        Places on an image, from (0, 0) at the lower left; NaN where there are none.
    colours : (n, 4)
        From 0 to 1; NaN where there are none.
    material : (m,)
        Its number in the document; -1 for none.
    document
    buffers
        Content of each of its buffers.
    """

    vertices: FloatArray
    faces: IntArray
    coordinates: FloatArray
    colours: FloatArray
    material: IntArray
    document: dict[str, Any]
    buffers: tuple[bytes, ...]


class _Part(NamedTuple):
    """What a scene has of some primitives that share their vertices."""

    vertices: FloatArray
    faces: IntArray
    coordinates: FloatArray
    colours: FloatArray
    material: IntArray


def read_gltf(path: Path) -> Scene:
    """The scene of a file, its parts placed and joined.

    Primitives of a mesh that share their positions share their vertices.

    Raises
    ------
    InputError
        If it is no glTF file, has no triangles, is compressed, or asks for what its size does not
        warrant: nodes that repeat each other, arrays of any size, files that are elsewhere.
    """
    document, binary = _content(path)
    _check_scene(document)
    needed = [*document.get("extensionsRequired", []), *document.get("extensionsUsed", [])]
    for name in needed:
        if name in _COMPRESSED:
            raise InputError(f"it is compressed ({name}); save it without compression.")
    for name in [*document.get("extensionsRequired", [])]:
        if not name.startswith(_KNOWN):
            raise InputError(f"it needs the extension {name}, which is not supported.")
    if "EXT_mesh_gpu_instancing" in needed:
        raise InputError("it repeats parts by EXT_mesh_gpu_instancing, which is not supported.")
    buffers = tuple(_buffer(buffer, binary, path) for buffer in document.get("buffers", []))
    parts = [
        part
        for mesh, matrix in _instances(document)
        for part in _mesh_parts(document, buffers, document["meshes"][mesh], matrix)
    ]
    if not sum(len(part.faces) for part in parts):
        raise InputError("there are no triangles in it.")
    sizes = [len(part.vertices) for part in parts]
    before = np.cumsum(sizes) - sizes  # vertices of the parts before each
    return Scene(
        vertices=np.concatenate([part.vertices for part in parts]),
        faces=np.concatenate([p.faces + b for p, b in zip(parts, before, strict=True)]),
        coordinates=np.concatenate([part.coordinates for part in parts]),
        colours=np.concatenate([part.colours for part in parts]),
        material=np.concatenate([part.material for part in parts]),
        document=document,
        buffers=buffers,
    )


def gltf_image(scene: Scene, number: int, path: Path) -> bytes:
    """The content of an image of a scene."""
    image = scene.document["images"][number]
    if "bufferView" in image:
        return _view(scene.document, scene.buffers, image["bufferView"])[0]
    return _resource(str(image["uri"]), path)


def _content(path: Path) -> tuple[dict[str, Any], bytes]:
    """The JSON document of a file, and the bytes that a GLB file has after it."""
    content, binary = path.read_bytes(), b""
    if path.suffix.lower() == ".glb":
        magic, _, announced, length, kind = struct.unpack_from("<4sIII4s", content)
        if magic != b"glTF" or kind != b"JSON" or not 20 + length <= announced <= len(content):
            raise InputError("it is no GLB file, or cut short.")
        at = 20 + length
        if at + 8 <= len(content):
            size, kind = struct.unpack_from("<I4s", content, at)
            binary = content[at + 8 : at + 8 + size] if kind == b"BIN\x00" else b""
        content = content[20:at]
    document = json.loads(content)
    if not isinstance(document, dict):
        raise InputError("there is no scene in it.")
    return document, binary


def _check_scene(document: dict[str, Any]) -> None:
    """Raise an `InputError` if a document asks for what its size does not warrant."""
    buffers, nodes = document.get("buffers", []), document.get("nodes", [])
    images = document.get("images", [])
    for uri in (each.get("uri", "data:") for each in [*buffers, *images]):
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


def _buffer(buffer: dict[str, Any], binary: bytes, path: Path) -> bytes:
    content = _resource(str(buffer["uri"]), path) if "uri" in buffer else binary
    if len(content) < int(buffer["byteLength"]):
        raise InputError(
            f"it announces {buffer['byteLength']} bytes of data and has {len(content)}; "
            "is it cut short?"
        )
    return content


def _resource(uri: str, path: Path) -> bytes:
    """Content of a `data:` URI, or of a file beside the document, whose name is percent-encoded."""
    if not uri.startswith("data:"):
        file = path.parent / unquote(uri)
        if not is_file(file):
            raise InputError(f"its file '{unquote(uri)}' is missing.")
        return file.read_bytes()
    head, _, data = uri.partition(",")
    if not head.endswith(";base64"):
        return unquote_to_bytes(data)
    try:
        return base64.b64decode(unquote(data))
    except binascii.Error as error:
        raise InputError(f"it holds data that is not base64: {error}.") from error


def _instances(document: dict[str, Any]) -> list[tuple[int, FloatArray]]:
    """Meshes of the scene and where they are, (4, 4), parents before their children."""
    nodes, scenes = document.get("nodes", []), document.get("scenes", [])
    if not nodes:
        return [(number, np.eye(4)) for number in range(len(document.get("meshes", [])))]
    children = {child for node in nodes for child in node.get("children", [])}
    roots = [number for number in range(len(nodes)) if number not in children]
    if scenes:
        roots = scenes[int(document.get("scene", 0))].get("nodes", [])
    found: list[tuple[int, FloatArray]] = []
    waiting: list[tuple[int, FloatArray]] = [(root, np.eye(4)) for root in reversed(roots)]
    while waiting:
        number, above = waiting.pop()
        node = nodes[number]
        matrix = above @ _matrix(node)
        if "mesh" in node:
            found.append((node["mesh"], matrix))
        waiting += [(child, matrix) for child in reversed(node.get("children", []))]
    return found


def _matrix(node: dict[str, Any]) -> FloatArray:
    if "matrix" in node:
        return np.array(node["matrix"], dtype=float).reshape(4, 4).T  # stored by columns
    result = np.eye(4)
    if "rotation" in node:
        from scipy.spatial.transform import Rotation  # slow to import

        result[:3, :3] = Rotation.from_quat(node["rotation"]).as_matrix()
    result[:3, :3] *= np.array(node.get("scale", [1, 1, 1]), dtype=float)
    result[:3, 3] = node.get("translation", [0, 0, 0])
    return result


def _mesh_parts(
    document: dict[str, Any],
    buffers: tuple[bytes, ...],
    mesh: dict[str, Any],
    matrix: FloatArray,
) -> list[_Part]:
    groups: dict[tuple[Any, ...], list[tuple[IntArray, int]]] = {}
    for primitive in mesh["primitives"]:
        if any(name in primitive.get("extensions", {}) for name in _COMPRESSED):
            raise InputError("it is compressed; save it without compression.")
        attributes = primitive["attributes"]
        mode = primitive.get("mode", _TRIANGLES)
        if "POSITION" not in attributes or mode not in (_TRIANGLES, _STRIP, _FAN):
            continue  # points and lines
        count = int(document["accessors"][attributes["POSITION"]]["count"])
        corners = np.arange(count)
        if "indices" in primitive:
            corners = accessor(document, buffers, primitive["indices"])[:, 0].astype(np.int64)
            if len(corners) and corners.max() >= count:
                raise InputError(f"a face names vertex {corners.max()}; there are {count}.")
        key = tuple(attributes.get(name) for name in ("POSITION", "TEXCOORD_0", "COLOR_0"))
        part = _triangles(corners, mode), int(primitive.get("material", -1))
        groups.setdefault(key, []).append(part)
    parts = []
    for (position, texture, colour), faces in groups.items():
        places = accessor(document, buffers, position)
        if places.shape[1] != 3:
            raise InputError(f"its positions have {places.shape[1]} coordinates; expected 3.")
        places = places @ matrix[:3, :3].T + matrix[:3, 3]
        on_image, shade = np.full((len(places), 2), np.nan), np.full((len(places), 4), np.nan)
        if texture is not None:
            on_image = _of_length(accessor(document, buffers, texture)[:, :2], len(places))
            on_image = np.stack([on_image[:, 0], 1 - on_image[:, 1]], axis=1)  # counted downwards
        if colour is not None:
            given = _of_length(accessor(document, buffers, colour), len(places))
            shade = np.ones((len(places), 4))
            shade[:, : given.shape[1]] = given
        joined = np.concatenate([each for each, _ in faces])
        if np.linalg.det(matrix[:3, :3]) < 0:
            joined = joined[:, ::-1]  # a reflection turns faces inside out
        material = np.repeat([number for _, number in faces], [len(each) for each, _ in faces])
        parts.append(_Part(places, joined, on_image, shade, material))
    return parts


def _of_length(values: FloatArray, count: int) -> FloatArray:
    if len(values) != count:
        raise InputError(f"it has {len(values)} values for {count} vertices.")
    return values


def _triangles(corners: IntArray, mode: int) -> IntArray:
    if mode == _TRIANGLES:
        return corners[: len(corners) // 3 * 3].reshape(-1, 3)
    if mode == _FAN:
        first = np.full(max(len(corners) - 2, 0), corners[0] if len(corners) else 0)
        return np.stack([first, corners[1:-1], corners[2:]], axis=1)
    faces = np.stack([corners[:-2], corners[1:-1], corners[2:]], axis=1)
    faces[1::2] = faces[1::2, [1, 0, 2]]  # every other triangle of a strip is turned round
    return faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]


def accessor(document: dict[str, Any], buffers: tuple[bytes, ...], number: int) -> FloatArray:
    """Values of an accessor, (count, width), divided where they are normalised."""
    held = document["accessors"][number]
    kind, width = np.dtype(_COMPONENTS[held["componentType"]]), _WIDTHS[held["type"]]
    count, sparse = int(held["count"]), held.get("sparse")
    if "bufferView" in held:
        data, stride = _view(document, buffers, held["bufferView"])
        values = _strided(data, int(held.get("byteOffset", 0)), stride, kind, (count, width))
    elif sparse:
        values = np.zeros((count, width), dtype=kind)
    else:
        raise InputError("it has values without data.")
    if sparse:
        size = int(sparse["count"])
        at, given = sparse["indices"], sparse["values"]
        index_kind = np.dtype(_COMPONENTS[at["componentType"]])
        data, _ = _view(document, buffers, at["bufferView"])
        index = _strided(data, int(at.get("byteOffset", 0)), 0, index_kind, (size, 1))[:, 0]
        data, _ = _view(document, buffers, given["bufferView"])
        values = values.copy()
        values[index] = _strided(data, int(given.get("byteOffset", 0)), 0, kind, (size, width))
    result = values.astype(float)
    if held.get("normalized") and kind.kind in "iu":
        result = np.maximum(result / np.iinfo(kind).max, -1.0)
    return result


def _view(document: dict[str, Any], buffers: tuple[bytes, ...], number: int) -> tuple[bytes, int]:
    """Bytes of a buffer view, and the distance of its values, 0 if they are close together."""
    view = document["bufferViews"][number]
    if any(name in view.get("extensions", {}) for name in _COMPRESSED):
        raise InputError("it is compressed; save it without compression.")
    start = int(view.get("byteOffset", 0))
    end = start + int(view["byteLength"])
    if not 0 <= start <= end <= len(buffers[view["buffer"]]):
        raise InputError("part of its data lies beyond the end; is it cut short?")
    return buffers[view["buffer"]][start:end], int(view.get("byteStride", 0))


def _strided(
    data: bytes, offset: int, stride: int, kind: np.dtype[Any], shape: tuple[int, int]
) -> npt.NDArray[Any]:
    count, width = shape
    size = width * kind.itemsize
    stride = stride or size
    if offset < 0 or stride < size or count < 0 or offset + stride * (count - 1) + size > len(data):
        raise InputError("its values lie beyond the end of their data; is it cut short?")
    return np.ndarray((count, width), kind, data, offset, (stride, kind.itemsize))
