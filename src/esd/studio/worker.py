"""What the studio computes, in a process of its own that keeps models and features at hand."""

from __future__ import annotations

import json
import logging
import signal
import struct
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, fields, replace
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from esd.common import FloatArray, InputError, IntArray, whole_file
from esd.datasets.folder import read_vts
from esd.evaluation.errors import true_map, vertex_errors
from esd.learning.model import Model, load_model
from esd.matching.along import transfer
from esd.matching.confidence import Adaptation, Judgement, Overlap
from esd.matching.correspondence import Correspondence, load_map, save_map
from esd.matching.features import Features
from esd.matching.landmarks import paired_landmarks
from esd.matching.match import match_features, prepared, working_features
from esd.mesh.geometry import surface_area
from esd.mesh.io.fields import read_labels, write_labels
from esd.mesh.io.landmarks import Landmarks
from esd.mesh.io.meshes import read_arrays, write_mesh
from esd.mesh.mesh import Mesh
from esd.mesh.repair.findings import Finding
from esd.mesh.repair.repair import Repaired, repair, usable_part
from esd.spectral.cache import default_cache
from esd.studio.looks import Kind, look, write_carried_look
from esd.viewing.scene import (
    PALETTE,
    Scene,
    mean_error,
    of_unit_area,
    scene,
    shape_arrays,
)
from esd.viewing.upright import default_up, usual_up

_MOST_FEATURES = 12  # shapes whose features are held
_PARTS: dict[str, Any] = {"adaptation": Adaptation, "overlap": Overlap}  # of a judgement

Reporter = Callable[[str, float], None]
"""Takes what is done now, and roughly the share of the task that is done."""


@dataclass(frozen=True, slots=True)
class Examine:
    """Read a mesh, look for defects, and compute its features for the matches to come."""

    path: Path
    name: str
    view: Path
    model: str


@dataclass(frozen=True, slots=True)
class Repair:
    """Write the repaired mesh to a new file."""

    path: Path
    output: Path


@dataclass(frozen=True, slots=True)
class Match:
    """Match two meshes, and write the map, its figures and what the browser shows."""

    source: Path
    target: Path
    names: tuple[str, str]
    map: Path
    figures: Path
    view: Path
    model: str
    mirror: str
    landmarks: tuple[Landmarks, Landmarks] | None = None


@dataclass(frozen=True, slots=True)
class Measure:
    """Measure a map that was found by a true one, or by the points of a template on both meshes.

    What the browser shows is written anew, with the error.
    """

    match: Match
    truth: Path | None
    points: tuple[Path, Path] | None


@dataclass(frozen=True, slots=True)
class Carry:
    """Carry labels, and a texture or colours, from the source of a map to its target."""

    source: Path
    target: Path
    map: Path
    labels: tuple[Path, Path] | None = None
    look: tuple[Kind, Path] | None = None


Task = Examine | Repair | Match | Measure | Carry


@dataclass(slots=True)
class _Memory:
    """What is kept from task to task, the least recently used features first."""

    models: dict[str, Model] = field(default_factory=dict)
    drawn: OrderedDict[Path, Mesh] = field(default_factory=OrderedDict)
    shapes: OrderedDict[Path, Repaired] = field(default_factory=OrderedDict)
    features: OrderedDict[tuple[Path, str], Features] = field(default_factory=OrderedDict)
    maps: OrderedDict[Path, Correspondence] = field(default_factory=OrderedDict)


def work(tasks: Connection, first_model: str) -> None:
    """Do tasks that come through a pipe, until it is closed.

    Answers with pairs: `progress` and what a `Reporter` takes, `done` and a result, or `failed` and
    why in one line.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # a terminal sends Ctrl-C to all processes
    logging.basicConfig(format="esd: %(message)s", level=logging.ERROR)
    memory = _Memory()
    try:
        _model(memory, first_model)  # before anyone waits for it
    except InputError:
        logging.getLogger(__name__).info("The model '%s' cannot be loaded yet.", first_model)
    while True:
        try:
            task = tasks.recv()
        except (EOFError, OSError):
            return
        try:
            result = done(task, memory, lambda *how_far: tasks.send(("progress", how_far)))
            tasks.send(("done", result))
        except BrokenPipeError:
            return
        except Exception as error:  # whatever fails is the task's own failure
            line = " ".join(str(error).split())
            known = isinstance(error, InputError | OSError)
            line = line if known else f"{type(error).__name__}: {line}"
            if isinstance(error, MemoryError):
                line = "There is not enough memory for this."
            tasks.send(("failed", _without_folders(line, task)))


def _without_folders(line: str, task: Task) -> str:
    """A line in which files of a task are named without the folder of the project."""
    for part in fields(task):
        value = getattr(task, part.name)
        if isinstance(value, Path):
            line = line.replace(str(value), value.name)
    return line


def done(task: Task, memory: _Memory, report: Reporter) -> dict[str, Any]:
    """The result of a task."""
    if isinstance(task, Examine):
        return _examined(task, memory, report)
    if isinstance(task, Repair):
        return _repaired(task, report)
    if isinstance(task, Measure):
        return _measured(task, memory, report)
    if isinstance(task, Carry):
        return _carried(task, memory, report)
    return _matched(task, memory, report)


def _examined(task: Examine, memory: _Memory, report: Reporter) -> dict[str, Any]:
    report("Reading", 0.0)
    vertices, faces = read_arrays(task.path)
    if len(faces) == 0:
        raise InputError("It has no faces; the studio shows meshes. Match points by esd match.")
    drawable = memory.drawn[task.path] = usable_part((vertices, faces))
    if not surface_area(drawable) > 0:
        raise InputError("Nothing can be drawn: its faces have no area.")
    kind, colours = look(task.path)
    up = default_up(drawable, usual=usual_up(task.path))
    _write_view(shape_scene(drawable, task.name, colours, up), task.view)
    report("Looking for defects", 0.15)
    repaired = _shape(memory, task.path)
    marked = [_as_dict(finding, drawable) for finding in repaired.diagnosis.findings]
    report("Computing spectrum and descriptors", 0.4)
    _features(memory, task.path, task.model)
    return {"vertices": len(vertices), "faces": len(faces), "findings": marked, "look": kind}


def _as_dict(finding: Finding, mesh: Mesh) -> dict[str, Any]:
    """A finding with the vertices where it is first; its number is that of a vertex or a face."""
    marked: list[int] = []
    if finding.first is not None:
        is_face = finding.kind.endswith(("faces", "slivers", "intersections", "spikes"))
        if not is_face and finding.first < len(mesh.vertices):
            marked = [finding.first]
        elif is_face and finding.first < len(mesh.faces):
            marked = mesh.faces[finding.first].tolist()
    return {
        "what": finding.what,
        "severity": finding.severity,
        "effect": finding.effect,
        "remedy": finding.remedy,
        "always": finding.always_repaired,
        "marked": marked,
    }


def _repaired(task: Repair, report: Reporter) -> dict[str, Any]:
    report("Repairing", 0.0)
    whole = repair(task.path, everything=True).compacted()
    if not isinstance(whole.shape, Mesh):
        raise InputError("Points cannot be repaired as a mesh.")
    write_mesh(whole.shape, task.output)
    return {"vertices": len(whole.shape.vertices)}


def _matched(task: Match, memory: _Memory, report: Reporter) -> dict[str, Any]:
    pairs: IntArray | None = None
    names: tuple[str, ...] = ()
    if task.landmarks is not None:
        names, pairs = paired_landmarks(*task.landmarks)
    report("Loading the model", 0.0)
    model = _model(memory, task.model)
    features = []
    for path, name, share in zip((task.source, task.target), task.names, (0.05, 0.3), strict=True):
        report(f"Computing spectrum and descriptors of {name}", share)
        features.append(_features(memory, path, task.model))
    report("Matching", 0.55)
    found = match_features(
        features[0],
        features[1],
        model=model,
        landmarks=pairs,
        mirror=task.mirror,  # type: ignore[arg-type]
    )
    report("Writing", 0.9)
    judged = found.judgement
    figures: dict[str, Any] = {
        "model": model.name,
        "mirror": task.mirror,
        "verdict": judged.verdict if judged else None,
        "expected_accuracy": judged.expected_accuracy if judged else None,
        "landmarks": list(names),
        "contradicted": [names[i] for i in judged.contradicted] if judged else [],
        "judgement": asdict(judged) if judged else None,
    }
    memory.maps[task.map] = found
    task.map.parent.mkdir(parents=True, exist_ok=True)
    save_map(found, task.map)
    _write_found(task, memory, figures)
    return figures


def _measured(task: Measure, memory: _Memory, report: Reporter) -> dict[str, Any]:
    report("Measuring geodesic errors", 0.0)
    match = task.match
    found = _found(memory, match)
    source, target = (_drawn(memory, path) for path in (match.source, match.target))
    counts = {"source_count": len(source.vertices), "target_count": len(target.vertices)}
    if task.truth is not None:
        truth = load_map(task.truth, **counts).target_index
    else:
        assert task.points is not None
        here, there = (read_vts(path) for path in task.points)
        truth = true_map(here, there, counts["source_count"])
    error = vertex_errors(target, found.target_index, truth)
    figures = json.loads(match.figures.read_text(encoding="utf-8"))
    figures["mean_error"] = mean_error(source, error)
    _write_found(match, memory, figures, error)
    return figures


def _carried(task: Carry, memory: _Memory, report: Reporter) -> dict[str, Any]:
    report("Carrying", 0.0)
    match = load_map(task.map)
    if task.labels is not None:
        labels, names = read_labels(task.labels[0])
        carried = transfer(labels, task.source, task.target, match, kind="labels")
        write_labels(carried, task.labels[1], names)
    if task.look is not None:
        kind, path = task.look
        write_carried_look(task.source, _drawn(memory, task.target), match, kind, path)
    return {}


def judgement_of(figures: dict[str, Any]) -> Judgement | None:
    """The judgement of a map among its figures, which files of maps do not hold."""
    kept = figures.get("judgement")
    if kept is None:
        return None
    parts = {
        name: kind(**kept[name]) for name, kind in _PARTS.items() if kept.get(name) is not None
    }
    return Judgement(**{**kept, **parts, "contradicted": tuple(kept["contradicted"])})


def _found(memory: _Memory, task: Match) -> Correspondence:
    """The map that a task found, from its files if it is not at hand."""
    if task.map not in memory.maps:
        figures = json.loads(task.figures.read_text(encoding="utf-8"))
        memory.maps[task.map] = replace(load_map(task.map), judgement=judgement_of(figures))
    found: Correspondence = _latest(memory.maps, task.map)
    return found


def _write_found(
    task: Match, memory: _Memory, figures: dict[str, Any], error: FloatArray | None = None
) -> None:
    """Write what the browser shows of a map that was found, and then its figures."""
    source, target = (_drawn(memory, path) for path in (task.source, task.target))
    shown = scene(
        source,
        target,
        _found(memory, task),
        error=error,
        source_name=task.names[0],
        target_name=task.names[1],
        model=figures["model"],
        up=default_up(source, usual=usual_up(task.source)),
    )
    _write_view(shown, task.view)
    with whole_file(task.figures) as temporary:
        # numbers of NumPy are written as those of Python
        temporary.write_text(json.dumps(figures, indent=1, default=float), encoding="utf-8")


def _model(memory: _Memory, name: str) -> Model:
    if name not in memory.models:
        memory.models[name] = load_model(name)
    return memory.models[name]


def _drawn(memory: _Memory, path: Path) -> Mesh:
    if path not in memory.drawn:
        memory.drawn[path] = usable_part(path)
    return _latest(memory.drawn, path)


def _shape(memory: _Memory, path: Path) -> Repaired:
    if path not in memory.shapes:
        memory.shapes[path] = prepared(path)
    return _latest(memory.shapes, path)


def _features(memory: _Memory, path: Path, model: str) -> Features:
    key = (path, model)
    if key not in memory.features:
        memory.features[key] = working_features(
            _shape(memory, path), model=_model(memory, model), cache=default_cache()
        )
    return _latest(memory.features, key)


def _latest(kept: OrderedDict[Any, Any], key: Any) -> Any:
    kept.move_to_end(key)
    while len(kept) > _MOST_FEATURES:
        kept.popitem(last=False)
    return kept[key]


def shape_scene(mesh: Mesh, name: str, colours: npt.NDArray[np.uint8], up: str) -> Scene:
    """What the viewer shows of a shape alone, with colours of its vertices (n, 3) if it has any."""
    mesh_of_unit_area = of_unit_area(mesh)
    meta = {
        "source": name,
        "target": "",
        "up": up,
        "radius": float(np.linalg.norm(mesh_of_unit_area.vertices, axis=1).max()),
        "fields": [],
        **PALETTE,
    }
    arrays = shape_arrays("source", mesh_of_unit_area)
    if len(colours) == len(mesh.vertices):
        arrays["texture"] = colours
    return Scene(meta, arrays)


def _write_view(shown: Scene, path: Path) -> None:
    with whole_file(path) as temporary:
        temporary.write_bytes(as_bytes(shown))


def as_bytes(shown: Scene) -> bytes:
    """A scene for the browser: the length of the JSON text, the text, and the arrays."""
    meta, content = shown.packed()
    head = json.dumps(meta).encode()
    head += b" " * (-len(head) % 4)  # so that arrays are aligned
    return struct.pack("<I", len(head)) + head + content
