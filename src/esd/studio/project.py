"""A project folder: shapes, landmarks and maps as ordinary files, written whole."""

from __future__ import annotations

import json
import re
import threading
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from esd.common import UNFINISHED, InputError, whole_file
from esd.mesh.io.landmarks import Landmarks
from esd.mesh.io.meshes import FORMATS
from esd.studio.looks import Kind

_VERSION = 1
_MOST_SHAPES = 200
_MOST_LANDMARKS = 500
_LONGEST_NAME = 100

QueuedKind = Literal["match", "measure", "carry", "repair"]


@dataclass(frozen=True, slots=True)
class Queued:
    """What is to be computed of a pair, or of one shape that is both.

    Parameters
    ----------
    kind
        The pair is matched, its map measured, what the source has is carried to the target, or a
        repaired copy of the source is added.
    source, target
        Numbers of the shapes.
    landmarks
        Whether the landmarks of both guide the map.
    """

    kind: QueuedKind
    source: int
    target: int
    landmarks: bool = False


@dataclass(frozen=True, slots=True)
class ProjectShape:
    """A shape of a project.

    Parameters
    ----------
    number
        Names it within the project.
    name
        Of the file that the user gave, for people to read.
    file
        Where it lies, relative to the project.
    vertices, faces
        How many there are; None until the shape has been examined.
    findings
        What is wrong with it: dicts of `what`, `severity`, `effect`, `remedy` and `marked`,
        vertices where it is.
    names, places
        Of its landmarks: names and vertices.
    up
        The axis that points up, as the user chose it; empty until then.
    look
        What its file colours it by: `texture`, `colours` of its vertices, or nothing.
    labels, points
        How many times the labels of its vertices or faces, and the vertices at the points of a
        template, by which maps are measured, were given; 0 for never.
    """

    number: int
    name: str
    file: str
    vertices: int | None = None
    faces: int | None = None
    findings: tuple[dict[str, Any], ...] = ()
    names: tuple[str, ...] = ()
    places: tuple[int, ...] = ()
    up: str = ""
    look: Kind = ""
    labels: int = 0
    points: int = 0

    def landmarks(self) -> Landmarks:
        """Its landmarks."""
        return Landmarks(self.names, np.array(self.places, dtype=np.int64))


class Project:
    """A project folder. Its methods may be called from several threads at once.

    `project.json` lists the shapes, with their landmarks; `meshes/` holds them as they were given,
    `maps/` a `.csv` file and a `.json` file of figures for each matched pair, `labels/` and
    `points/` a file for each shape that has them, `truth/` the true map of a pair where it is
    known, and `carried/` shapes with the texture of another. `queue/` has a file for each thing
    that is to be computed. What `views/` holds is computed from these.

    Raises
    ------
    InputError
        If the folder holds other things and no project, or a damaged one.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._lock = threading.RLock()
        self._shapes: dict[int, ProjectShape] = {}
        self._next = 1
        self._settings: dict[str, str] = {}
        last = max((path.stem for path, _ in self.queue()), default="0")
        self._queued = int(last) if last.isdigit() else 0
        path = folder / "project.json"
        if path.is_file():
            self._read(path)
        elif folder.is_dir() and any(folder.iterdir()):
            raise InputError(
                f"'{folder}' holds other files and no project; give a new folder, or that of a "
                "project."
            )
        else:
            self._write()

    def _read(self, path: Path) -> None:
        try:
            content = json.loads(path.read_text(encoding="utf-8"))
            if content["version"] != _VERSION:
                raise InputError(f"'{path}' is by another version of esd.")
            for entry in content["shapes"]:
                for key in ("findings", "names", "places"):
                    entry[key] = tuple(entry[key])
                shape = ProjectShape(**entry)
                self._shapes[shape.number] = shape
            self._next = int(content["next"])
            self._settings = dict(content["settings"])
        except (OSError, ValueError, KeyError, TypeError) as error:
            if isinstance(error, InputError):
                raise
            raise InputError(f"'{path}' is damaged: {error}.") from error
        for path in self.folder.rglob(f"{UNFINISHED}*"):
            path.unlink(missing_ok=True)  # of a process that was killed
        for shape in list(self._shapes.values()):
            if not (self.folder / shape.file).is_file():
                del self._shapes[shape.number]

    def _write(self) -> None:
        content = {
            "version": _VERSION,
            "next": self._next,
            "settings": self._settings,
            "shapes": [asdict(shape) for shape in self._shapes.values()],
        }
        with whole_file(self.folder / "project.json") as temporary:
            temporary.write_text(json.dumps(content, indent=1), encoding="utf-8")

    def shapes(self) -> tuple[ProjectShape, ...]:
        """All shapes, in the order in which they were added."""
        with self._lock:
            return tuple(self._shapes.values())

    def shape(self, number: int) -> ProjectShape:
        """The shape of a number; raises an `InputError` if there is none."""
        with self._lock:
            if number not in self._shapes:
                raise InputError(f"There is no shape {number} in this project.")
            return self._shapes[number]

    def path(self, shape: ProjectShape) -> Path:
        """Where the file of a shape is."""
        return self.folder / shape.file

    def add(self, name: str, content: Path) -> ProjectShape:
        """A new shape of a file, which is moved into the project.

        Raises
        ------
        InputError
            If the name is none of a mesh, or there are too many shapes.
        """
        name = check_mesh_name(name)
        with self._lock:
            if len(self._shapes) >= _MOST_SHAPES:
                raise InputError(f"A project has at most {_MOST_SHAPES} shapes.")
            number = self._next
            plain = re.sub(r"[^A-Za-z0-9_-]+", "_", name.removesuffix(suffix_of(name)))[:60]
            shape = ProjectShape(number, name, f"meshes/{number}-{plain}{suffix_of(name)}")
            self.path(shape).parent.mkdir(exist_ok=True)
            content.replace(self.path(shape))
            self._next += 1
            self._shapes[number] = shape
            self._write()
            return shape

    def remove(self, number: int) -> None:
        """Remove a shape with its maps."""
        with self._lock:
            shape = self.shape(number)
            del self._shapes[number]
            self._write()
            self.path(shape).unlink(missing_ok=True)
            for folder in ("maps", "views", "labels", "points", "truth"):
                for path in (self.folder / folder).glob("*"):
                    if str(number) in path.stem.split("-"):
                        path.unlink(missing_ok=True)

    def examined(
        self, number: int, vertices: int, faces: int, findings: list[dict[str, Any]], look: str
    ) -> None:
        """Keep what was found out about a shape."""
        self._change(number, vertices=vertices, faces=faces, findings=tuple(findings), look=look)

    def set_up(self, number: int, axis: str) -> None:
        """Keep which axis of a shape points up."""
        self._change(number, up=axis)

    def given(self, number: int, what: Literal["labels", "points"]) -> None:
        """Count that the labels or points of a shape were written."""
        with self._lock:
            self._change(number, **{what: getattr(self.shape(number), what) + 1})

    def _change(self, number: int, **changes: Any) -> None:
        with self._lock:
            self._shapes[number] = replace(self.shape(number), **changes)
            self._write()

    def set_landmarks(self, number: int, names: list[Any], places: list[Any]) -> None:
        """Replace the landmarks of a shape.

        Raises
        ------
        InputError
            If they are not as many names as vertices of the shape, or a name is given twice.
        """
        with self._lock:
            shape = self.shape(number)
            if len(names) != len(places) or len(names) > _MOST_LANDMARKS:
                raise InputError(
                    f"Expected as many names as vertices, {_MOST_LANDMARKS} at most; "
                    f"got {len(names)} and {len(places)}."
                )
            for name in names:
                if not isinstance(name, str) or not 0 < len(name.strip()) <= _LONGEST_NAME:
                    raise InputError(f"Names of landmarks have 1 to {_LONGEST_NAME} characters.")
                if not name.isprintable():
                    raise InputError("Names of landmarks have printable characters only.")
            if len(set(names)) < len(names):
                raise InputError("Two landmarks of a shape have one name.")
            count = shape.vertices or 0
            for place in places:
                if not isinstance(place, int) or not 0 <= place < count:
                    raise InputError(f"Landmarks are vertices from 0 to {count - 1}; got {place}.")
            self._change(number, names=tuple(names), places=tuple(places))

    def settings(self) -> dict[str, str]:
        """What the user chose last."""
        with self._lock:
            return dict(self._settings)

    def set_settings(self, settings: dict[str, str]) -> None:
        """Keep what the user chose."""
        with self._lock:
            self._settings = settings
            self._write()

    def map_path(self, source: int, target: int, suffix: str = ".csv") -> Path:
        """Where the map of a pair is, or with `.json` its figures."""
        return self.folder / "maps" / f"{source}-{target}{suffix}"

    def view_path(self, *numbers: int) -> Path:
        """Where that is which the browser shows of a shape, or of a pair."""
        return self.folder / "views" / ("-".join(map(str, numbers)) + ".bin")

    def labels_path(self, number: int) -> Path:
        """Where the labels of a shape are, a word or number a line."""
        return self.folder / "labels" / f"{number}.txt"

    def points_path(self, number: int) -> Path:
        """Where the vertices of a shape at the points of a template are, from 1."""
        return self.folder / "points" / f"{number}.vts"

    def truth_path(self, source: int, target: int) -> Path:
        """Where the true map of a pair is."""
        return self.folder / "truth" / f"{source}-{target}.csv"

    def carried_path(self, source: int, target: int) -> Path:
        """Where the target with the texture of the source is."""
        stems = (
            self.shape(number).file.split("/")[-1].split(".")[0] for number in (target, source)
        )
        return self.folder / "carried" / ("-by-".join(stems) + ".glb")

    def enqueue(self, queued: Queued) -> Path:
        """A new file that keeps what is to be computed, until the file is removed."""
        with self._lock:
            folder = self.folder / "queue"
            folder.mkdir(exist_ok=True)
            self._queued += 1
            path = folder / f"{self._queued:08d}.json"
        with whole_file(path) as temporary:
            temporary.write_text(json.dumps(asdict(queued)), encoding="utf-8")
        return path

    def queue(self) -> list[tuple[Path, Queued | None]]:
        """The files of what is to be computed, in order; None for damaged ones."""
        return [(path, _queued(path)) for path in sorted((self.folder / "queue").glob("*.json"))]

    def maps(self) -> list[dict[str, Any]]:
        """The figures of all maps, those of the lowest expected accuracy first."""
        found = []
        with self._lock:
            for path in sorted((self.folder / "maps").glob("*-*.json")):
                source, _, target = path.stem.partition("-")
                is_ours = source.isdigit() and target.isdigit()
                if not is_ours or not {int(source), int(target)} <= set(self._shapes):
                    continue
                try:
                    figures = json.loads(path.read_text(encoding="utf-8"))
                except (OSError, ValueError):  # a map without figures is computed anew
                    continue
                if path.with_suffix(".csv").is_file() and isinstance(figures, dict):
                    stamp = str(path.stat().st_mtime_ns)  # changes when it is matched again
                    numbers = {"source": int(source), "target": int(target)}
                    found.append({**figures, **numbers, "stamp": stamp})
        return sorted(found, key=lambda figures: figures.get("expected_accuracy") or 0.0)


def _queued(path: Path) -> Queued | None:
    try:
        queued = Queued(**json.loads(path.read_text(encoding="utf-8")))
    except (OSError, ValueError, TypeError):
        return None
    return queued if queued.kind in get_args(QueuedKind) else None


def suffix_of(name: str) -> str:
    """The suffix of a mesh file's name, with that of a packed one: `.ply`, `.off.gz`."""
    lower = name.lower()
    for suffix in FORMATS:
        for ending in (suffix, f"{suffix}.gz"):
            if lower.endswith(ending):
                return ending
    return ""


def check_mesh_name(name: str) -> str:
    """The last part of a name, if it is that of a mesh; raises an `InputError` otherwise."""
    last = re.split(r"[/\\]", name)[-1]
    last = "".join(letter for letter in last if letter.isprintable())[-_LONGEST_NAME:]
    if not suffix_of(last):
        raise InputError(f"'{last}' is not a mesh file; expected one of {', '.join(FORMATS)}.")
    return last
