"""Surfaces of VTK: the data set POLYDATA of legacy files (`.vtk`), and XML files (`.vtp`).

Read here because meshio reads neither; other data sets of VTK are its.
"""

from __future__ import annotations

import base64
import binascii
import zlib
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

import numpy as np
import numpy.typing as npt

from esd.common import InputError, IntArray
from esd.mesh.io.polygons import strip_triangles, triangulated

_HEAD = 4096  # bytes of a legacy file in which its data set is named
_LARGEST = 2**30  # bytes that an array may unpack to
_LEGACY_TYPES = {
    "char": "i1",
    "unsigned_char": "u1",
    "short": ">i2",
    "unsigned_short": ">u2",
    "int": ">i4",
    "unsigned_int": ">u4",
    "long": ">i8",
    "unsigned_long": ">u8",
    "float": ">f4",
    "double": ">f8",
    "vtkidtype": ">i4",
    "vtktypeint32": ">i4",
    "vtktypeint64": ">i8",
}
_XML_TYPES = {
    **{f"Int{8 * size}": f"i{size}" for size in (1, 2, 4, 8)},
    **{f"UInt{8 * size}": f"u{size}" for size in (1, 2, 4, 8)},
    **{f"Float{8 * size}": f"f{size}" for size in (4, 8)},
}


class Surface(NamedTuple):
    """Vertices (n, 3), triangles (m, 3), and the number of polygons and triangles of strips."""

    vertices: npt.NDArray[Any]
    faces: IntArray
    polygon_count: int


def is_legacy_polydata(path: Path) -> bool:
    """Whether a `.vtk` file holds the data set POLYDATA."""
    with path.open("rb") as file:
        words = file.read(_HEAD).upper().split()
    return b"POLYDATA" in words[words.index(b"DATASET") :][:2] if b"DATASET" in words else False


def read_legacy(path: Path) -> Surface:
    """The polygons and strips of a legacy file with the data set POLYDATA.

    Raises
    ------
    InputError
        If it is cut short, or not as the format says.
    """
    content = path.read_bytes()
    start, _, rest = content.partition(b"\n")
    version = float(start.split()[-1])
    is_text = rest.split(b"\n", 2)[1].strip().upper() == b"ASCII"
    file = _Legacy(content, is_text)
    while (words := file.line()) and words[0].upper() != "DATASET":
        pass
    vertices: npt.NDArray[Any] = np.zeros((0, 3))
    polygons, strips = _NONE, _NONE
    while words := file.line():
        kind = words[0].upper()
        if kind == "POINTS":
            vertices = file.numbers(3 * int(words[1]), words[2]).reshape(-1, 3)
        elif kind in ("VERTICES", "LINES", "POLYGONS", "TRIANGLE_STRIPS"):
            cells = file.cells(int(words[1]), int(words[2]), has_offsets=version >= 5)
            polygons = cells if kind == "POLYGONS" else polygons
            strips = cells if kind == "TRIANGLE_STRIPS" else strips
        elif kind == "FIELD":
            for _ in range(int(words[2])):
                _, width, count, type_name = file.line()
                file.numbers(int(width) * int(count), type_name)
        elif kind == "METADATA":
            file.skip_paragraph()
        else:  # data of points or cells, which come last
            break
    return _surface(vertices, polygons, strips)


def read_vtp(path: Path) -> Surface:
    """The polygons and strips of all pieces of an XML file of VTK.

    Raises
    ------
    InputError
        If it is of another kind, or packed by another method than zlib.
    """
    content = path.read_bytes()
    at = content.find(b"<AppendedData")
    appended = b""
    if at >= 0:  # it may be raw bytes, which are no XML
        appended = content[content.index(b"_", at) + 1 : content.rindex(b"</AppendedData")]
        is_raw = b'"raw"' in content[at : content.index(b"_", at)]
        content = content[:at] + b"</VTKFile>"
    else:
        is_raw = False
    try:
        root = ElementTree.fromstring(content)
    except ElementTree.ParseError as error:
        raise InputError(f"it is no XML: {error}.") from error
    if root.get("type") != "PolyData":
        raise InputError(f"it holds {root.get('type')}; expected PolyData.")
    compressor = root.get("compressor", "")
    if compressor not in ("", "vtkZLibDataCompressor"):
        raise InputError(f"it is packed by {compressor}; save it unpacked, or with zlib.")
    order = ">" if root.get("byte_order") == "BigEndian" else "<"
    arrays = _XmlArrays(
        np.dtype(order + _XML_TYPES[root.get("header_type", "UInt32")]),
        compressor != "",
        appended,
        is_raw,
    )
    parts: list[Surface] = []
    for piece in root.iter("Piece"):
        points = piece.find("Points/DataArray")
        if points is None:
            continue
        vertices = arrays.values(points, order).reshape(-1, 3)
        cells = []
        for name in ("Polys", "Strips"):
            named = {each.get("Name"): each for each in piece.iterfind(f"{name}/DataArray")}
            if {"connectivity", "offsets"} <= set(named):
                corners = arrays.values(named["connectivity"], order).astype(np.int64)
                ends = arrays.values(named["offsets"], order).astype(np.int64)
                cells.append(_Cells(corners, np.diff(ends, prepend=0)))
            else:
                cells.append(_NONE)
        parts.append(_surface(vertices, *cells))
    if not parts:
        raise InputError("there are no points in it.")
    starts = np.cumsum([0, *(len(part.vertices) for part in parts)])
    return Surface(
        np.concatenate([part.vertices for part in parts]),
        np.concatenate([part.faces + k for part, k in zip(parts, starts, strict=False)]),
        sum(part.polygon_count for part in parts),
    )


class _Cells(NamedTuple):
    """Corners of cells, one after the other, and how many each has."""

    corners: IntArray
    counts: IntArray


_NONE = _Cells(np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64))


def _surface(vertices: npt.NDArray[Any], polygons: _Cells, strips: _Cells) -> Surface:
    for cells in (polygons, strips):
        if (cells.counts < 0).any() or cells.counts.sum() != len(cells.corners):
            raise InputError("the numbers of corners do not fit its lists of them.")
    cut = triangulated(vertices, polygons.corners, polygons.counts)
    parts = [polygons.corners[cut.corners].reshape(-1, 3)]
    ends = np.cumsum(strips.counts)[:-1]
    parts += [strip_triangles(strip) for strip in np.split(strips.corners, ends)]
    faces = np.concatenate(parts)
    return Surface(vertices, faces, len(polygons.counts) + len(faces) - len(parts[0]))


class _Legacy:
    """A legacy file, read from its start to its end."""

    def __init__(self, content: bytes, is_text: bool) -> None:
        self.content, self.is_text, self.at = content, is_text, 0

    def line(self) -> list[str]:
        """Words of the next line that is not empty; none at the end."""
        while self.at < len(self.content):
            end = self.content.find(b"\n", self.at)
            end = len(self.content) if end < 0 else end
            words = self.content[self.at : end].decode("latin-1").split()
            self.at = end + 1
            if words:
                return words
        return []

    def skip_paragraph(self) -> None:
        """Go on after the next empty line."""
        end = self.content.find(b"\n\n", self.at)
        self.at = len(self.content) if end < 0 else end + 2

    def numbers(self, count: int, type_name: str) -> npt.NDArray[Any]:
        """The next numbers, of one of VTK's types."""
        if type_name.lower() not in _LEGACY_TYPES:
            raise InputError(f"it has numbers of the type '{type_name}', which is not read.")
        dtype = np.dtype(_LEGACY_TYPES[type_name.lower()])
        left = len(self.content) - self.at
        if not 0 <= count * (1 if self.is_text else dtype.itemsize) <= left:
            raise InputError(f"it announces {count} numbers and ends before; is it cut short?")
        if not self.is_text:
            values = np.frombuffer(self.content, dtype, count, self.at)
            self.at += count * dtype.itemsize
            return values.astype(dtype.newbyteorder("="))
        words = self.content[self.at :].split(None, count)
        if len(words) < count:
            raise InputError(f"it announces {count} numbers and ends before; is it cut short?")
        self.at = len(self.content) - len(words[count]) if len(words) > count else len(self.content)
        return np.array(words[:count], dtype=float).astype(dtype.newbyteorder("="))

    def cells(self, first: int, second: int, *, has_offsets: bool) -> _Cells:
        """The next cells: offsets and corners since version 5, before that one list of both."""
        if has_offsets:
            ends = self.numbers(first, self.line()[1]).astype(np.int64)
            corners = self.numbers(second, self.line()[1]).astype(np.int64)
            return _Cells(corners, np.diff(ends)) if first else _NONE
        flat = self.numbers(second, "int").astype(np.int64)
        if first and len(flat) % first == 0 and (flat[:: len(flat) // first] == flat[0]).all():
            width = len(flat) // first  # all cells have as many corners
            if flat[0] == width - 1:
                return _Cells(flat.reshape(first, width)[:, 1:].ravel(), np.full(first, flat[0]))
        counts: list[int] = []
        is_count, at = np.zeros(len(flat), dtype=bool), 0
        while at < len(flat) and len(counts) < first:
            counts.append(int(flat[at]))
            is_count[at] = True
            at += max(0, counts[-1]) + 1
        return _Cells(flat[~is_count], np.array(counts, dtype=np.int64))


class _XmlArrays(NamedTuple):
    """How the arrays of an XML file are kept."""

    header: np.dtype[Any]
    is_packed: bool
    appended: bytes
    is_raw: bool

    def values(self, element: ElementTree.Element, order: str) -> npt.NDArray[Any]:
        """The numbers of a `DataArray`."""
        dtype = np.dtype(order + _XML_TYPES[element.get("type", "")])
        form = element.get("format", "ascii")
        if form == "ascii":
            return np.array((element.text or "").split(), dtype=float).astype(
                dtype.newbyteorder("=")
            )
        if form == "appended":
            data = self.appended[int(element.get("offset", "0")) :]
            content = self._raw(data) if self.is_raw else self._text(data)
        else:
            content = self._text((element.text or "").strip().encode())
        return np.frombuffer(content, dtype).astype(dtype.newbyteorder("="))

    def _raw(self, data: bytes) -> bytes:
        size = self.header.itemsize
        first = int(np.frombuffer(_part(data, 0, size), self.header)[0])
        if not self.is_packed:
            return _part(data, size, first)
        head = _part(data, 0, size * (3 + first))  # `first` is the number of blocks
        return _unpacked(np.frombuffer(head, self.header), data[len(head) :])

    def _text(self, data: bytes) -> bytes:
        """What is in base64: the header and the data together, or one after the other."""
        size = self.header.itemsize
        head = _decoded(data, size)
        if not self.is_packed:
            count = int(np.frombuffer(head, self.header)[0])
            if data[: _length(size)].endswith(b"="):
                return _decoded(data[_length(size) :], count)
            return _decoded(data, size + count)[size:]
        blocks = int(np.frombuffer(head, self.header)[0])
        sizes = np.frombuffer(_decoded(data, size * (3 + blocks)), self.header)
        rest = data[_length(size * (3 + blocks)) :]
        return _unpacked(sizes, _decoded(rest, int(sizes[3:].sum())))


def _length(count: int) -> int:
    """Number of characters of so many bytes in base64."""
    return 4 * -(-count // 3)


def _decoded(data: bytes, count: int) -> bytes:
    """So many bytes of what is in base64."""
    if not 0 <= count <= len(data):
        raise InputError("an array is cut short.")
    try:
        return _part(base64.b64decode(data[: _length(count)]), 0, count)
    except binascii.Error as error:
        raise InputError(f"an array is no base64: {error}.") from error


def _part(data: bytes, start: int, count: int) -> bytes:
    if not 0 <= count <= len(data) - start:
        raise InputError("an array is cut short.")
    return data[start : start + count]


def _unpacked(head: npt.NDArray[Any], data: bytes) -> bytes:
    """The blocks that zlib packed, whose head is their number, two sizes, and each packed size."""
    if int(head[0]) * int(head[1]) > _LARGEST:
        raise InputError("an array unpacks to more than 1 GiB.")
    ends = np.cumsum(head[3:].astype(np.int64)).tolist()
    sizes = head[3:].tolist()
    try:
        return b"".join(
            zlib.decompressobj().decompress(data[end - size : end], int(head[1]))
            for end, size in zip(ends, sizes, strict=True)
        )
    except zlib.error as error:
        raise InputError(f"an array cannot be unpacked: {error}.") from error
