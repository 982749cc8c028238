"""The template registered to each shape of a collection; what is done is kept and not repeated."""

from __future__ import annotations

import json
import logging
import os
from collections.abc import Callable
from dataclasses import asdict, dataclass, fields, is_dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import numpy.typing as npt

from esd.common import InputError, IntArray, whole_file
from esd.datasets.collection import Collection, Shape
from esd.learning.model import Model
from esd.matching.batch import load_features, save_features
from esd.matching.landmarks import paired_landmarks
from esd.matching.match import match_features, prepared, working_features
from esd.mesh.io.landmarks import LANDMARK_FORMATS, Landmarks, read_landmarks
from esd.mesh.io.ply import ply_bytes, ply_elements
from esd.mesh.mesh import Mesh
from esd.parallel import Workers, outcomes, shared_folder
from esd.population.missing import missing_parts
from esd.registration.register import register
from esd.spectral.cache import content_key, default_cache

_log = logging.getLogger(__name__)

_VERSION = 2  # part of the fingerprints; raised when a registration may change


@dataclass(frozen=True, slots=True)
class RegisteredShape:
    """What became of a shape.

    Parameters
    ----------
    name, subject
        See `esd.datasets.collection.Shape`.
    fingerprint
        Of everything that the registration depends on.
    verdict, expected_accuracy
        Of the map, see `esd.matching.confidence.Judgement`; None where it was not judged.
    distance
        Mean distance to the surface over the longest side of the bounding box.
    supported
        Share of the template's vertices where the shape has a surface.
    covered
        Share of the shape's area where the template lies.
    inverted
        Faces against their neighbours, that are not in the template.
    failure
        Why there is no registration; empty if there is one.
    is_new
        Whether it was computed, and not found.
    """

    name: str
    subject: str
    fingerprint: str = ""
    verdict: str | None = None
    expected_accuracy: float | None = None
    distance: float = float("nan")
    supported: float = 0.0
    covered: float = float("nan")
    inverted: int = 0
    failure: str = ""
    is_new: bool = True


@dataclass(frozen=True, slots=True, eq=False)
class Template:
    """The mesh that is registered, and its landmarks."""

    mesh: Mesh
    landmarks: Landmarks | None = None


def with_landmarks(collection: Collection, folder: str | os.PathLike[str]) -> Collection:
    """The collection with the landmarks in a folder, named as the shapes.

    Shapes that have none there are matched without.

    Raises
    ------
    InputError
        If there is no such folder, or no landmarks of any shape in it.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise InputError(f"There is no folder of landmarks '{folder}'.")
    shapes, lacking = [], []
    for shape in collection.shapes:
        file = landmark_file(folder, shape.name)
        if file is None:
            lacking.append(shape.name)
        read = None if file is None else partial(_landmarks, file, shape)
        shapes.append(replace(shape, landmarks=read))
    if len(lacking) == len(shapes):
        some = collection.shapes[0].name
        raise InputError(
            f"'{folder}' holds landmarks of no shape of '{collection.name}'; expected files such "
            f"as '{some}.csv' ({', '.join(LANDMARK_FORMATS)})."
        )
    if lacking:
        _log.warning("Without landmarks in '%s': %s.", folder, ", ".join(lacking))
    return replace(collection, shapes=tuple(shapes))


def landmark_file(folder: Path, name: str) -> Path | None:
    """The file of a shape's landmarks in a folder, if there is one."""
    files = (folder / f"{name}{suffix}" for suffix in LANDMARK_FORMATS)
    return next((file for file in files if file.is_file()), None)


def registered_shapes(
    collection: Collection,
    template: Template,
    folder: Path,
    *,
    model: Model,
    workers: Workers,
    on_shape: Callable[[], None] = lambda: None,
) -> tuple[RegisteredShape, ...]:
    """Register a template to all shapes of a collection, each to a file of a folder.

    `NAME.ply` has the template's vertices on the shape, with the attribute `supported`; `NAME.json`
    what is known of it, with a fingerprint of the shape, template, landmarks and model. A shape
    whose files have the same fingerprint is not registered again; a shape that fails does not
    abort the others.

    Parameters
    ----------
    folder
        Must exist. Workers of a scheduler must see it under the same name.
    on_shape
        Called after each shape, to show progress.
    """
    settings = content_key(
        "template",
        template.mesh.vertices,
        template.mesh.faces,
        landmarks=_landmark_key(template.landmarks),
        model=model_key(model),
        version=_VERSION,
    )
    done: dict[str, RegisteredShape] = {}
    begun = [shape for shape in collection.shapes if _figures_file(folder, shape.name).is_file()]
    look = partial(_found, folder=folder, settings=settings)
    for found in outcomes(look, begun, workers=workers):
        if found.result is not None:
            done[found.job.name] = found.result
            on_shape()
    pending = [shape for shape in collection.shapes if shape.name not in done]
    with shared_folder(workers) as temporary:
        if pending:
            features = working_features(prepared(template.mesh), model=model, cache=default_cache())
            save_features(features, temporary / "template")
        work = partial(
            _registered,
            template=template,
            features=temporary / "template",
            folder=folder,
            model=model,
            settings=settings,
        )
        for outcome in outcomes(work, pending, workers=workers):
            shape = outcome.job
            done[shape.name] = outcome.result or RegisteredShape(
                shape.name, shape.subject, failure=outcome.failure or "unknown"
            )
            on_shape()
    return tuple(done[shape.name] for shape in collection.shapes)


def read_registered(folder: Path, name: str, faces: IntArray) -> npt.NDArray[np.float64]:
    """The template's vertices on a shape, (n, 3); NaN in parts that the shape lacks.

    Raises
    ------
    InputError
        If there is no such file, or it is not as `registered_shapes` wrote it.
    """
    path = _mesh_file(folder, name)
    try:
        columns = ply_elements(path)["vertex"]
        vertices = np.stack([np.asarray(columns[axis], dtype=float) for axis in "xyz"], axis=1)
        supported = np.asarray(columns["supported"], dtype=bool)
    except (OSError, KeyError, InputError) as error:
        raise InputError(
            f"'{path}' cannot be read as a registered shape ({error}); remove it and rerun."
        ) from error
    missing = missing_parts(Mesh(vertices, faces), supported)
    return np.where(missing[:, None], np.nan, vertices)


def model_key(model: Model) -> str:
    """Key of what a model computes: equal for equal weights and descriptors, whatever its name."""
    arrays: list[npt.NDArray[np.generic]] = []
    plain: list[object] = []

    def collect(value: object) -> None:
        if isinstance(value, np.ndarray):
            arrays.append(value)
        elif is_dataclass(value):
            for field in fields(value):
                collect(getattr(value, field.name))
        elif isinstance(value, tuple):
            plain.append(len(value))
            for each in value:
                collect(each)
        else:
            plain.append(value)

    collect(replace(model, name="", card={}, device=""))
    return content_key("model", *arrays, plain=plain)


def _figures_file(folder: Path, name: str) -> Path:
    return folder / f"{name}.json"


def _mesh_file(folder: Path, name: str) -> Path:
    return folder / f"{name}.ply"


def _fingerprint(settings: str, mesh: Mesh, landmarks: Landmarks | None) -> str:
    return content_key(
        "registered",
        mesh.vertices,
        mesh.faces,
        landmarks=_landmark_key(landmarks),
        settings=settings,
    )


def _landmark_key(landmarks: Landmarks | None) -> str:
    if landmarks is None:
        return "none"
    return content_key("landmarks", landmarks.vertices, names=landmarks.names)


def _found(shape: Shape, *, folder: Path, settings: str) -> RegisteredShape | None:
    """What was done of a shape before, if it was done of the same."""
    try:
        known = json.loads(_figures_file(folder, shape.name).read_text(encoding="utf-8"))
        record = RegisteredShape(**{**known, "is_new": False})
    except (OSError, ValueError, TypeError):
        return None
    landmarks = shape.landmarks() if shape.landmarks else None
    same = record.fingerprint == _fingerprint(settings, shape.mesh(), landmarks)
    if not same or not _mesh_file(folder, shape.name).is_file():
        return None
    return replace(record, subject=shape.subject)


def _registered(
    shape: Shape, *, template: Template, features: Path, folder: Path, model: Model, settings: str
) -> RegisteredShape:
    """Register the template to a shape, and write its files: the one with the figures last."""
    mesh = shape.mesh()
    landmarks = shape.landmarks() if shape.landmarks else None
    pairs = None
    if landmarks is not None and template.landmarks is not None:
        _, pairs = paired_landmarks(template.landmarks, landmarks)
    cache = default_cache()
    match = match_features(
        load_features(features),
        working_features(prepared(mesh), model=model, cache=cache),
        model=model,
        landmarks=pairs,
        mirror="no",
    )
    found = register(template.mesh, mesh, correspondence=match)
    judged = match.judgement
    record = RegisteredShape(
        name=shape.name,
        subject=shape.subject,
        fingerprint=_fingerprint(settings, mesh, landmarks),
        verdict=judged.verdict if judged else None,
        expected_accuracy=judged.expected_accuracy if judged else None,
        distance=found.quality.relative_distance,
        supported=found.quality.supported,
        covered=found.quality.covered,
        inverted=found.quality.inverted,
    )
    with whole_file(_mesh_file(folder, shape.name)) as temporary:
        supported = found.supported.astype(np.uint8)
        temporary.write_bytes(ply_bytes(found.mesh, {"supported": supported}))
    with whole_file(_figures_file(folder, shape.name)) as temporary:
        temporary.write_text(json.dumps(asdict(record), indent=1), encoding="utf-8")
    return record


def _landmarks(file: Path, shape: Shape) -> Landmarks:
    return read_landmarks(file, shape.mesh())
