"""Files of landmarks: tables, 3D Slicer's markups, `.pts` and `.tps`."""

from __future__ import annotations

import csv
import io
import itertools
import json
import math
import os
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple, TypeAlias

import numpy as np
from scipy.spatial import KDTree

from esd.common import (
    FloatArray,
    InputError,
    IntArray,
    existing_file,
    reason,
    table_rows,
    whole_file,
)
from esd.mesh.mesh import Mesh, PointCloud

_MARKUPS_SCHEMA = (
    "https://raw.githubusercontent.com/slicer/slicer/master/Modules/Loadable/Markups/Resources/"
    "Schema/markups-schema-v1.0.3.json#"
)
_TOLERANCE = 0.05  # of the bounding diagonal: a click is off by this much at most
_UNITS = {
    "metres to millimetres": 1000.0,
    "centimetres to millimetres": 10.0,
    "metres to centimetres": 100.0,
    "inches to millimetres": 25.4,
    "inches to centimetres": 2.54,
    "inches to metres": 0.0254,
}
_AXES = {
    "x and y negated (LPS for RAS)": ((0, 1, 2), (-1, -1, 1)),
    "x negated": ((0, 1, 2), (-1, 1, 1)),
    "y negated": ((0, 1, 2), (1, -1, 1)),
    "z negated": ((0, 1, 2), (1, 1, -1)),
    "x and z negated": ((0, 1, 2), (-1, 1, -1)),
    "y and z negated": ((0, 1, 2), (1, -1, -1)),
    "(x, y, z) as (x, z, -y)": ((0, 2, 1), (1, 1, -1)),
    "(x, y, z) as (x, -z, y)": ((0, 2, 1), (1, -1, 1)),
}


@dataclass(frozen=True, slots=True, eq=False)
class Landmarks:
    """Named vertices of a mesh.

    Parameters
    ----------
    names
        One for each landmark.
    vertices : (l,) int64
        From 0; -1 for a landmark that is missing.
    """

    names: tuple[str, ...]
    vertices: IntArray


class _Row(NamedTuple):
    """A landmark as a file has it: a vertex, or a position, (nan, nan, nan) if it is missing."""

    name: str
    position: tuple[float, ...]
    vertex: int | None = None


def read_landmarks(path: str | os.PathLike[str], mesh: Mesh | PointCloud) -> Landmarks:
    """Landmarks of a mesh, in a file of one of `LANDMARK_FORMATS`.

    A `.csv` file has the columns `name` and `vertex`, from 0, or `name`, `x`, `y` and `z`. Of
    positions the nearest vertex is taken. Empty cells and coordinates that are not numbers (NaN)
    mean that the landmark is missing. `.fcsv` and `.mrk.json` files of 3D Slicer say whether they
    are in LPS or RAS; the mesh is taken to be in LPS, as Slicer writes meshes. Landmarks of
    `.tps` files, and of `.pts` files without names, are numbered from 1.

    Raises
    ------
    InputError
        If there is no such file or it is not as described, a landmark is no vertex of the mesh, or
        lies more than 5 % of the mesh's bounding diagonal off the surface. The message then says
        which unit or axes would explain it.
    """
    path = Path(path)
    read = LANDMARK_FORMATS[_format(path)][0]
    existing_file(path)
    try:
        rows = read(path.read_text(encoding="utf-8-sig"))
    except InputError as error:
        raise InputError(f"'{path}' {error}") from error
    except UnicodeDecodeError as error:
        raise InputError(f"'{path}' cannot be read: {reason(error)}.") from error
    except OSError as error:
        raise InputError(f"'{path}' cannot be read: {error.strerror or error}.") from error
    except (ValueError, TypeError, KeyError, IndexError, AttributeError, csv.Error) as error:
        raise InputError(
            f"'{path}' holds something else than landmarks: {reason(error)}."
        ) from error
    if not rows:
        raise InputError(f"'{path}' holds no landmarks.")
    vertices = np.array([-1 if row.vertex is None else row.vertex for row in rows])
    named = np.array([row.vertex is not None for row in rows])
    if named.any() and not 0 <= vertices[named].min() <= vertices.max() < len(mesh.vertices):
        raise InputError(
            f"'{path}' names vertices from {vertices[named].min()} to {vertices.max()}; "
            f"the mesh has those from 0 to {len(mesh.vertices) - 1}."
        )
    positions = np.array([row.position for row in rows], dtype=float)
    placed = ~named & np.isfinite(positions).all(axis=1)
    if placed.any():
        names = [row.name for row, is_placed in zip(rows, placed, strict=True) if is_placed]
        vertices[placed] = _nearest_vertices(positions[placed], names, mesh, path)
    return Landmarks(tuple(row.name for row in rows), vertices)


def write_landmarks(
    landmarks: Landmarks, mesh: Mesh | PointCloud, path: str | os.PathLike[str]
) -> None:
    """Write landmarks in the format of the suffix, one of `LANDMARK_FORMATS`.

    CSV has the columns `name,vertex,x,y,z`. A missing landmark has empty cells in CSV, NaN in
    `.pts` and `.tps`, and is marked as missing in `.mrk.json`; `.fcsv` leaves it out.

    Raises
    ------
    InputError
        If the suffix is another, or the file cannot be written.
    """
    path = Path(path)
    write = LANDMARK_FORMATS[_format(path)][1]
    vertices = landmarks.vertices.tolist()
    rows = [
        _Row(name, tuple(mesh.vertices[vertex].tolist()) if vertex >= 0 else _MISSING, vertex)
        for name, vertex in zip(landmarks.names, vertices, strict=True)
    ]
    with whole_file(path) as temporary:
        temporary.write_text(write(rows), encoding="utf-8")


_MISSING = (math.nan, math.nan, math.nan)


def _format(path: Path) -> str:
    for suffix in LANDMARK_FORMATS:
        if path.name.lower().endswith(suffix):
            return suffix
    known = ", ".join(LANDMARK_FORMATS)
    raise InputError(f"'{path}': landmarks are in files whose names end in {known}.")


def _nearest_vertices(
    points: FloatArray, names: list[str], mesh: Mesh | PointCloud, path: Path
) -> IntArray:
    """The vertex nearest to each point, if the points are near the surface."""
    faces = mesh.faces if isinstance(mesh, Mesh) else np.zeros((0, 3), dtype=np.int64)
    used = np.unique(faces) if len(faces) else np.arange(len(mesh.vertices))
    corners = mesh.vertices[used]
    diagonal = float(np.linalg.norm(np.ptp(corners, axis=0)))
    edge = np.zeros(len(mesh.vertices))
    for side in ((0, 1), (1, 2), (2, 0)):
        ends = faces[:, side]
        length = np.linalg.norm(np.subtract(*mesh.vertices[ends.T]), axis=1)
        for column in ends.T:
            np.maximum.at(edge, column, length)
    tree = KDTree(corners)
    points = np.clip(points, -1e100, 1e100)  # squares of greater ones overflow

    # a point on a large face is up to half an edge and more from all of its corners
    def excess(moved: FloatArray) -> tuple[FloatArray, IntArray, FloatArray]:
        distance, nearest = tree.query(moved)
        return distance - edge[used[nearest]] - _TOLERANCE * diagonal, nearest, distance

    over, nearest, distance = excess(points)
    worst = int(over.argmax())
    if over[worst] <= 0:
        return np.asarray(used[nearest])
    explained = _explanations(points, excess, least=_TOLERANCE * diagonal)
    hint = (
        f"With {explained} they would be on the surface; convert the file."
        if explained
        else "Check that they belong to this mesh, its unit and its axes."
    )
    raise InputError(
        f"'{path}': the landmark '{names[worst]}' is {distance[worst]:.4g} from the mesh, "
        f"{distance[worst] / diagonal:.0%} of its diagonal; expected at most {_TOLERANCE:.0%}. "
        f"{hint}"
    )


def _explanations(
    points: FloatArray,
    excess: Callable[[FloatArray], tuple[FloatArray, IntArray, FloatArray]],
    *,
    least: float,
) -> str:
    """The change of unit, of axes, or of both that brings all points onto the surface, if one.

    A unit that leaves the points less than `least` apart explains nothing: it brings any points
    to one place.
    """
    extent = float(np.linalg.norm(np.ptp(points, axis=0)))
    factors = {f"{name} (times {value:g})": value for name, value in _UNITS.items()}
    for name, value in _UNITS.items():
        first, second = name.split(" to ")
        factors[f"{second} to {first} (times {1 / value:g})"] = 1 / value
    units = {"": 1.0} | factors
    axes = {"": ((0, 1, 2), (1, 1, 1))} | _AXES
    # the fewest changes first
    for allowed in ("unit", "axes", "both"):
        best, found = math.inf, ""
        for (unit, factor), (axis, (order, sign)) in itertools.product(units.items(), axes.items()):
            kind = "both" if unit and axis else "unit" if unit else "axes" if axis else ""
            if kind != allowed or (unit and factor * extent < least):
                continue
            over, _, distance = excess(factor * points[:, order] * sign)
            if over.max() <= 0 and distance.mean() < best:
                best, found = float(distance.mean()), " and ".join(filter(None, (unit, axis)))
        if found:
            return found
    return ""


def _read_csv(text: str) -> list[_Row]:
    columns, table = table_rows(text)
    if not ({"name", "vertex"} <= columns or {"name", "x", "y", "z"} <= columns):
        raise InputError("must have the columns name,vertex or name,x,y,z.")
    rows = []
    for _, cells in table:
        vertex = cells.get("vertex", "")
        if vertex and int(vertex) != -1:
            rows.append(_Row(cells["name"], _MISSING, int(vertex)))
        elif vertex:  # -1, as it is written
            rows.append(_Row(cells["name"], _MISSING))
        else:
            rows.append(_Row(cells["name"], _position(cells.get(axis, "") for axis in "xyz")))
    return rows


def _write_csv(rows: list[_Row]) -> str:
    content = io.StringIO()
    table = csv.writer(content, lineterminator="\n")
    table.writerow(("name", "vertex", "x", "y", "z"))
    for row in rows:
        place = ("", "", "") if math.isnan(row.position[0]) else row.position
        table.writerow((row.name, row.vertex, *place))
    return content.getvalue()


def _read_fcsv(text: str) -> list[_Row]:
    lines = text.splitlines()
    comments = [line[1:].split("=", 1) for line in lines if line.startswith("#")]
    head = {pair[0].strip().lower(): pair[1].strip() for pair in comments if len(pair) == 2}
    columns = head.get("columns", "id,x,y,z,ow,ox,oy,oz,vis,sel,lock,label").split(",")
    columns = [name.strip() for name in columns]
    sign = _to_lps(head.get("coordinatesystem", "RAS"))
    rows = []
    for number, cells in enumerate(
        csv.reader(line for line in lines if line.strip() and line[:1] != "#"), start=1
    ):
        row = dict(zip(columns, cells, strict=False))
        x, y, z = _position(row[axis] for axis in "xyz")
        name = row.get("label", "").strip() or str(number)
        rows.append(_Row(name, (sign * x, sign * y, z)))
    return rows


def _write_fcsv(rows: list[_Row]) -> str:
    content = io.StringIO()
    content.write("# Markups fiducial file version = 4.11\n# CoordinateSystem = LPS\n")
    content.write("# columns = id,x,y,z,ow,ox,oy,oz,vis,sel,lock,label,desc,associatedNodeID\n")
    table = csv.writer(content, lineterminator="\n")
    for number, row in enumerate(rows, start=1):
        if not math.isnan(row.position[0]):
            table.writerow((number, *row.position, 0, 0, 0, 1, 1, 1, 0, row.name, "", ""))
    return content.getvalue()


def _read_markups(text: str) -> list[_Row]:
    document = json.loads(text)
    rows = []
    for markup in document["markups"]:
        sign = _to_lps(str(markup.get("coordinateSystem", "LPS")))
        for number, point in enumerate(markup["controlPoints"], start=1):
            name = str(point.get("label") or number)
            if point.get("positionStatus", "defined") != "defined" or not point.get("position"):
                rows.append(_Row(name, _MISSING))
                continue
            x, y, z = (float(value) for value in point["position"])
            rows.append(_Row(name, (sign * x, sign * y, z)))
    return rows


def _write_markups(rows: list[_Row]) -> str:
    points = []
    for number, row in enumerate(rows, start=1):
        missing = math.isnan(row.position[0])
        status = "missing" if missing else "defined"
        place = [0.0, 0.0, 0.0] if missing else list(row.position)
        points.append(
            {"id": str(number), "label": row.name, "position": place, "positionStatus": status}
        )
    markup = {"type": "Fiducial", "coordinateSystem": "LPS", "controlPoints": points}
    return json.dumps({"@schema": _MARKUPS_SCHEMA, "markups": [markup]}, indent=1) + "\n"


def _to_lps(system: str) -> int:
    """What x and y are multiplied by; 3D Slicer numbers the systems in older files."""
    if system.upper() in ("LPS", "1"):
        return 1
    if system.upper() in ("RAS", "0"):
        return -1
    raise InputError(f"has the coordinate system '{system}'; expected LPS or RAS.")


def _read_pts(text: str) -> list[_Row]:
    """Positions a line, or a name and a position, after a head of lines of one or two words."""
    lines = [line.split() for line in text.splitlines() if line.strip()]
    start = next((i for i, words in enumerate(lines) if len(words) > 2), len(lines))
    if start < len(lines) and lines[start][0].lower().startswith("version"):
        raise InputError("holds points of an image; expected x, y and z of each.")
    rows = []
    for number, words in enumerate(lines[start:], start=1):
        if len(words) not in (3, 4):
            raise InputError(f"has a line that is no landmark: '{' '.join(words)}'.")
        name = words[0] if len(words) == 4 else str(number)
        rows.append(_Row(name, _position(words[-3:])))
    counts = [int(words[0]) for words in lines[:start] if len(words) == 1 and words[0].isdigit()]
    if counts and counts[-1] != len(rows):
        raise InputError(f"announces {counts[-1]} landmarks and has {len(rows)}; is it cut short?")
    return rows


def _write_pts(rows: list[_Row]) -> str:
    lines = [" ".join((_one_word(row.name), *map(repr, row.position))) for row in rows]
    return "\n".join(("Version 1.0", "S", str(len(rows)), *lines, ""))


def _read_tps(text: str) -> list[_Row]:
    """The landmarks of one specimen in three dimensions, times its scale."""
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    keys = [line.split("=")[0].strip().upper() if "=" in line else "" for line in lines]
    if keys.count("LM3") != 1 or "LM" in keys:
        raise InputError("must hold one specimen with LM3=, landmarks in three dimensions.")
    start = keys.index("LM3") + 1
    count = int(lines[start - 1].split("=")[1])
    values = dict(zip(keys, (line.split("=")[-1] for line in lines), strict=True))
    scale = float(values.get("SCALE", 1.0))
    points = list(itertools.takewhile(lambda line: "=" not in line, lines[start:]))
    if count != len(points):
        raise InputError(f"announces {count} landmarks and has {len(points)}; is it cut short?")
    rows = []
    for number, line in enumerate(points, start=1):
        x, y, z = _position(line.split())
        rows.append(_Row(str(number), (scale * x, scale * y, scale * z)))
    return rows


def _write_tps(rows: list[_Row]) -> str:
    lines = [" ".join(map(repr, row.position)) for row in rows]
    return "\n".join((f"LM3={len(rows)}", *lines, "ID=0", ""))


def _position(words: Iterable[str]) -> tuple[float, ...]:
    """Three numbers; missing ones are empty, NaN or NA."""
    cells = [word.strip() for word in words]
    values = tuple(math.nan if cell.lower() in ("", "na") else float(cell) for cell in cells)
    if len(values) != 3:
        raise InputError(f"has a position of {len(values)} numbers; expected x, y and z.")
    return values


def _one_word(name: str) -> str:
    return "_".join(name.split()) or "_"


_Reader: TypeAlias = Callable[[str], list[_Row]]
_Writer: TypeAlias = Callable[[list[_Row]], str]

LANDMARK_FORMATS: dict[str, tuple[_Reader, _Writer]] = {
    ".csv": (_read_csv, _write_csv),
    ".fcsv": (_read_fcsv, _write_fcsv),
    ".mrk.json": (_read_markups, _write_markups),
    ".pts": (_read_pts, _write_pts),
    ".tps": (_read_tps, _write_tps),
}
"""Ends of the names of landmark files, and what reads and writes each."""
