"""PLY, text and binary: whatever lists and properties it declares."""

from __future__ import annotations

import re
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from esd.common import InputError, IntArray
from esd.mesh.io.polygons import polygon_count, strip_triangles, triangulated
from esd.mesh.mesh import Mesh, PointCloud

_TYPES = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("long", "int64"), "i8"),
    **dict.fromkeys(("ulong", "uint64"), "u8"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}
_NAMES = {
    **{"i1": "char", "u1": "uchar", "i2": "short", "u2": "ushort", "i4": "int", "u4": "uint"},
    **{"f4": "float", "f8": "double"},
}
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}

Array: TypeAlias = npt.NDArray[Any]
Lists: TypeAlias = tuple[Array, Array]
"""Items of all lists of a property, one after the other, and the length of each."""


@dataclass(frozen=True, slots=True)
class _Property:
    name: str
    item: str
    count: str = ""  # type of the length of a list


@dataclass(frozen=True, slots=True)
class _Element:
    name: str
    count: int
    properties: tuple[_Property, ...]


def read_ply(path: Path) -> tuple[Array, IntArray, int]:
    """Vertices, faces and the number of polygons of a PLY file.

    Faces are those of `face` and of `tristrips`; there are none if the file declares none.

    Raises
    ------
    InputError
        If it is no PLY file, is cut short, or has faces or edges that cannot be used.
    """
    content = ply_elements(path)
    vertex = content.get("vertex", {})
    if any(not isinstance(vertex.get(axis), np.ndarray) for axis in "xyz"):
        raise InputError("its vertices have no x, y and z.")
    vertices = np.stack([np.asarray(vertex[axis], dtype=float) for axis in "xyz"], axis=1)
    face, strips = content.get("face", {}), content.get("tristrips", {})
    parts, polygons = [np.zeros((0, 3), dtype=np.int64)], 0
    if face:
        corners, counts = _list_of(face, "face")
        parts.append(corners[triangulated(vertices, corners, counts).corners])
        polygons += polygon_count(path, counts)
    if strips:
        for strip in np.split(*_ends(_list_of(strips, "tristrips"))):
            parts += [strip_triangles(part) for part in np.split(strip, np.flatnonzero(strip < 0))]
        polygons += sum(map(len, parts)) - len(parts[1] if face else ())
    faces = np.concatenate(parts)
    edges = content.get("edge", {})
    if edges and not len(faces):
        raise InputError("it has edges and no faces; a surface is needed.")
    if (face or strips) and not len(faces):
        raise InputError("none of its faces has three corners.")
    return vertices, faces, polygons


def ply_elements(path: Path) -> dict[str, dict[str, Array | Lists]]:
    """Each element's properties, by name; elements of which there are none are left out.

    Raises
    ------
    InputError
        If it is no PLY file or is cut short.
    """
    content = path.read_bytes()
    elements, order, start = _header(content)
    read: Any = _Binary(content, start, order) if order else _Text(content[start:].split())
    result: dict[str, dict[str, Array | Lists]] = {}
    for element in elements:
        if element.count > read.left():
            raise InputError(
                f"it announces {element.count} of '{element.name}', more than it holds; "
                "is it cut short?"
            )
        if element.count and element.properties:
            result[element.name] = _rows(element, read)
    return result


def ply_bytes(
    mesh: Mesh | PointCloud,
    attributes: Mapping[str, Array] | None = None,
    face_attributes: Mapping[str, Array] | None = None,
) -> bytes:
    """A binary PLY file of a shape, coordinates of 64 bits, with numbers at vertices and faces.

    Integers of 64 bits, which PLY does not have, become floating-point numbers.
    """
    positions = dict(zip("xyz", mesh.vertices.T.astype("<f8"), strict=True))
    columns = {**positions, **_columns(attributes or {})}
    vertices = np.empty(len(mesh.vertices), [(name, v.dtype) for name, v in columns.items()])
    for name, values in columns.items():
        vertices[name] = values
    corners = mesh.faces if isinstance(mesh, Mesh) else np.zeros((0, 3), dtype=np.int64)
    of_faces = _columns(face_attributes or {})
    faces = np.empty(
        len(corners),
        [("count", "u1"), ("corners", "<i4", 3), *((n, v.dtype) for n, v in of_faces.items())],
    )
    faces["count"], faces["corners"] = 3, corners
    for name, values in of_faces.items():
        faces[name] = values
    head = [
        f"ply\nformat binary_little_endian 1.0\nelement vertex {len(vertices)}",
        *_properties(columns),
        f"element face {len(faces)}",
        "property list uchar int vertex_indices",
        *_properties(of_faces),
        "end_header\n",
    ]
    return "\n".join(head).encode() + vertices.tobytes() + faces.tobytes()


def _columns(attributes: Mapping[str, Array]) -> dict[str, Array]:
    """Numbers in the types that PLY has, in little-endian order."""
    return {
        name: values.astype(f"<{kind}" if (kind := values.dtype.str[1:]) in _NAMES else "<f8")
        for name, values in attributes.items()
    }


def _properties(columns: Mapping[str, Array]) -> list[str]:
    return [f"property {_NAMES[v.dtype.str[1:]]} {name}" for name, v in columns.items()]


def _header(content: bytes) -> tuple[list[_Element], str, int]:
    """Elements, byte order (empty for text) and where the body begins."""
    ending = re.search(rb"[\r\n][ \t]*end_header", content)  # a comment may name it, too
    if content[:3] != b"ply" or ending is None:
        raise InputError("it does not begin with `ply`, or its head has no end.")
    end = ending.end() - len(b"end_header")
    after = content.find(b"\n", end)
    start = len(content) if after < 0 else after + 1
    if content[end + 10 : end + 11] == b"\r" and content[end + 11 : end + 12] != b"\n":
        start = end + 11  # old Macintosh ends of lines
    lines = [line.split() for line in content[:end].decode("latin-1").splitlines()]
    form = next((words[1] for words in lines if words[:1] == ["format"] and words[1:]), "none")
    if form not in _ORDERS:
        raise InputError(f"its format is '{form}', which PLY does not have.")
    elements: list[_Element] = []
    for words in lines:
        if words[:1] == ["element"]:
            count = int(words[2])
            if count < 0:
                raise InputError(f"it announces {count} of '{words[1]}'.")
            elements.append(_Element(words[1], count, ()))
        elif words[:1] == ["property"]:
            last = elements.pop()
            try:
                is_list = words[1] == "list"
                kinds = [_TYPES[word] for word in (words[2:4] if is_list else words[1:2])]
            except KeyError as error:
                raise InputError(f"PLY has no type {error}.") from error
            added = _Property(words[-1], kinds[-1], kinds[0] if is_list else "")
            elements.append(_Element(last.name, last.count, (*last.properties, added)))
    return elements, _ORDERS[form], start


class _Text:
    """Numbers of a text file, one after the other."""

    def __init__(self, words: list[bytes]) -> None:
        self.words, self.at = words, 0

    def left(self) -> int:
        return len(self.words) - self.at

    def alike(self, element: _Element) -> dict[str, Array] | None:
        """Columns of rows that are all as long as the first one; None if they are not."""
        widths, row = [], self.at
        for each in element.properties:
            width = int(self.words[row]) if each.count else 1
            widths.append(width)
            row += width + bool(each.count)
        size = row - self.at
        if min(widths) < 0 or size * element.count > self.left():
            return None
        end = self.at + size * element.count
        table = np.array(self.words[self.at : end], dtype="S").reshape(element.count, size)
        columns, column = {}, 0
        for each, width in zip(element.properties, widths, strict=True):
            if each.count:
                if (table[:, column] != table[0, column]).any():
                    return None
                column += 1
            columns[each.name] = _converted(table[:, column : column + width], each)
            column += width
        self.at = end
        return columns

    def take(self, kind: str, count: int) -> list[Any]:
        if not 0 <= count <= self.left():
            raise InputError("a list ends beyond the end of the file; it is cut short.")
        words = self.words[self.at : self.at + count]
        self.at += count
        return list(map(float if kind[0] == "f" else int, words))


class _Binary:
    """Numbers of a binary file, one after the other."""

    def __init__(self, content: bytes, at: int, order: str) -> None:
        self.content, self.at, self.order = content, at, order

    def left(self) -> int:
        return len(self.content) - self.at

    def alike(self, element: _Element) -> dict[str, Array] | None:
        """Columns of rows that are all as long as the first one; None if they are not."""
        fields: list[Any] = []
        at = self.at
        for number, each in enumerate(element.properties):
            width = 1
            if each.count:
                fields.append((f"count{number}", self.order + each.count))
                (width,) = self.take(each.count, 1)
            if width < 0 or width > self.left():
                self.at = at
                return None
            fields.append((f"item{number}", self.order + each.item, (width,)))
            self.at += width * int(each.item[1])
        self.at = at
        row = np.dtype(fields)
        if row.itemsize * element.count > self.left():
            return None
        table = np.frombuffer(self.content, row, count=element.count, offset=self.at)
        lengths = [name for name in row.names or () if name.startswith("count")]
        if any((table[name] != table[name][0]).any() for name in lengths):
            return None
        self.at += row.itemsize * element.count
        return {each.name: table[f"item{i}"] for i, each in enumerate(element.properties)}

    def take(self, kind: str, count: int) -> list[Any]:
        letter = {"i1": "b", "u1": "B", "i2": "h", "u2": "H", "i4": "i", "u4": "I"}
        letter |= {"i8": "q", "u8": "Q", "f4": "f", "f8": "d"}
        size = count * int(kind[1])
        if not 0 <= size <= self.left():
            raise InputError("a list ends beyond the end of the file; it is cut short.")
        values = struct.unpack_from(f"{self.order}{count}{letter[kind]}", self.content, self.at)
        self.at += size
        return list(values)


def _rows(element: _Element, read: _Text | _Binary) -> dict[str, Array | Lists]:
    columns = read.alike(element)
    result: dict[str, Array | Lists] = {}
    if columns is not None:
        for each in element.properties:
            values = columns[each.name]
            lengths = np.full(element.count, values.shape[1])
            result[each.name] = (values.ravel(), lengths) if each.count else values[:, 0]
        return result
    # rows of different lengths, such as triangles among quads: one after the other
    items: list[list[Any]] = [[] for _ in element.properties]
    counts: list[list[int]] = [[] for _ in element.properties]
    for _ in range(element.count):
        for each, row, number in zip(element.properties, items, counts, strict=True):
            length = int(read.take(each.count, 1)[0]) if each.count else 1
            row.extend(read.take(each.item, length))
            number.append(length)
    for each, row, number in zip(element.properties, items, counts, strict=True):
        flat = np.array(row, dtype=each.item)
        result[each.name] = (flat, np.array(number, dtype=np.int64)) if each.count else flat
    return result


def _converted(words: Array, each: _Property) -> Array:
    try:
        if each.item[0] == "f":
            return words.astype(float)
        whole = words.astype(np.int64)
        declared = whole.astype(each.item)  # a value beyond the type keeps 64 bits
        return declared if (declared == whole).all() else whole
    except ValueError:  # integers that are written as 1.0
        return words.astype(float).astype(each.item)


def _list_of(element: dict[str, Array | Lists], name: str) -> tuple[IntArray, IntArray]:
    for key in ("vertex_indices", "vertex_index"):
        found = element.get(key)
        if isinstance(found, tuple):
            return found[0].astype(np.int64), found[1].astype(np.int64)
    raise InputError(f"its element '{name}' has no list `vertex_indices`.")


def _ends(lists: tuple[IntArray, IntArray]) -> tuple[IntArray, IntArray]:
    return lists[0], np.cumsum(lists[1])[:-1]
