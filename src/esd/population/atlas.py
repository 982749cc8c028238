"""The atlas of a population: registered meshes, mean shape, principal modes, scores, outliers."""

from __future__ import annotations

import json
import logging
import os
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree

from esd.common import UNFINISHED, BoolArray, InputError, IntArray, whole_file
from esd.datasets.collection import Collection, Shape
from esd.datasets.open import open_collection
from esd.learning.model import Model, load_model
from esd.matching.match import DEFAULT_MODEL
from esd.mesh.convert import MeshLike, as_mesh
from esd.mesh.geometry import surface_area, vertex_areas
from esd.mesh.io.landmarks import Landmarks, read_landmarks
from esd.mesh.io.meshes import read_mesh, write_mesh
from esd.mesh.mesh import Mesh
from esd.mesh.repair.repair import usable_part
from esd.parallel import THIS_PROCESS, Workers, outcomes, shared_folder
from esd.population.missing import completed, is_present
from esd.population.procrustes import generalised_procrustes
from esd.population.quality import ModelQuality, model_quality, outliers
from esd.population.registering import (
    RegisteredShape,
    Template,
    landmark_file,
    model_key,
    read_registered,
    registered_shapes,
    with_landmarks,
)
from esd.population.shape_model import ShapeModel, principal_components
from esd.population.template import as_template, medoid, shape_dna
from esd.spectral.cache import content_key, default_cache

_log = logging.getLogger(__name__)

FEWEST = 3
"""Shapes of which there are statistics."""

_FORMAT = 1
_SETTINGS_FILE, _TEMPLATE_FILE, _REGISTERED = "atlas.json", "template.ply", "registered"
TRAINED = "trained"
"""Folder within that of an atlas, of a model that was trained for it."""
_OWN = {
    *(_SETTINGS_FILE, _TEMPLATE_FILE, _REGISTERED, TRAINED, f"{TRAINED}.checkpoint"),
    *("model.npz", "mean.ply", "scores.csv", "modes.csv", "shapes.csv", "report.html"),
}
_FAR = 0.01  # of the extent: mean distance to the scan beyond which a registration has failed
_COVERED = 0.85  # share of a shape's area that the template must cover
_OTHER_UNIT = 5.0  # times larger or smaller than the median: not a size but a unit of length
_FEWEST_SEEN = 2  # shapes that must have a vertex for it to be in the statistics


@dataclass(frozen=True, slots=True, eq=False)
class Atlas:
    """Registered shapes of a population and their statistics.

    The s shapes of the statistics are those of `names`; `shapes` has those that were left out, too.

    Parameters
    ----------
    shapes
        What became of each shape.
    left_out
        Name of each shape that is not in the statistics, and the reason.
    names, subjects
        Of the s shapes.
    faces : (m, 3)
        Of the template, and so of all registered shapes.
    vertices : (s, n, 3)
        Of the template on each shape, in its coordinates; NaN in parts that the shape lacks, see
        `esd.population.missing.missing_parts`.
    aligned : (s, n, 3)
        The same after generalised Procrustes alignment.
    sizes : (s,)
        Root mean square distance of each shape from its centre.
    scores : (s, k)
        In the principal modes, in units of length.
    distance : (s,)
        Of each aligned shape from the mean: the root mean square over the surface.
    is_outlier : (s,)
        Whether that is larger than usual, see `esd.population.quality.outliers`.
    model : ShapeModel
        Mean shape and modes.
    quality : ModelQuality
        Compactness, generalisation and specificity.
    template : str
        Name of the shape or file that is the template.
    """

    shapes: tuple[RegisteredShape, ...]
    left_out: dict[str, str]
    names: tuple[str, ...]
    subjects: tuple[str, ...]
    faces: IntArray
    vertices: npt.NDArray[np.float64]
    aligned: npt.NDArray[np.float64]
    sizes: npt.NDArray[np.float64]
    scores: npt.NDArray[np.float64]
    distance: npt.NDArray[np.float64]
    is_outlier: BoolArray
    model: ShapeModel
    quality: ModelQuality
    template: str

    def __repr__(self) -> str:
        return (
            f"<Atlas of {len(self.names)} shapes: {len(self.model.modes)} modes, "
            f"{len(self.left_out)} shapes left out, {self.is_outlier.sum()} outliers>"
        )

    @property
    def mean(self) -> npt.NDArray[np.float64]:
        """Mean shape, (n, 3)."""
        return self.model.mean

    @property
    def modes(self) -> npt.NDArray[np.float64]:
        """Principal modes, (k, n, 3)."""
        return self.model.modes

    @property
    def variances(self) -> npt.NDArray[np.float64]:
        """Variances of the scores in the modes, (k,)."""
        return self.model.variances


def atlas(
    shapes: Collection | str | os.PathLike[str] | Sequence[MeshLike],
    *,
    template: MeshLike = "auto",
    model: Model | str | os.PathLike[str] = DEFAULT_MODEL,
    landmarks: str | os.PathLike[str] | None = None,
    registered: bool = False,
    keep_size: bool = False,
    keep_failed: bool = False,
    modes: int | None = None,
    vertex_count: int = 10_000,
    folder: str | os.PathLike[str] | None = None,
    renew: bool = False,
    workers: Workers = THIS_PROCESS,
    on_shape: Callable[[], None] = lambda: None,
) -> Atlas:
    """The atlas of a population of unregistered shapes of one class.

    The template is registered to each shape along a map, see `esd.register`; the registered meshes
    are aligned by generalised Procrustes, and their principal components computed. Vertices in
    parts that a shape lacks are missing: they take no part in the alignment, and are estimated from
    the other shapes for the principal components alone.

    Shapes that fail do not abort the others; those whose map or registration failed are left out of
    the statistics.

    Parameters
    ----------
    shapes
        A folder or another data set that `open_collection` takes, a `Collection`, or a sequence of
        meshes. Correspondences that it may have are not used.
    template
        A mesh, or whatever `as_mesh` takes; `auto` takes the shape with the least sum of distances
        to all others, by the eigenvalues of their Laplace-Beltrami operators.
    model
        Of the maps: a `Model`, or what `load_model` takes.
    landmarks
        Folder of landmarks named as the shapes and the template; by default those of the data set.
    registered
        Whether the shapes have one connectivity and equal indices correspond: nothing is matched.
    keep_size
        Whether the alignment moves and rotates but does not scale.
    keep_failed
        Whether shapes whose map or registration failed stay in the statistics.
    modes
        Number of modes that are kept; by default all.
    vertex_count
        About how many vertices an automatic template has at most.
    folder
        Where registered shapes are kept; a run that was interrupted is resumed from there.
    renew
        Whether what is there of other settings is replaced.
    workers
        What computes. Workers of a scheduler must see the files under the same names.
    on_shape
        Called twice for each shape, when it may have been chosen as the template and when it is
        registered; once if the shapes are registered.

    Raises
    ------
    InputError
        If fewer than three shapes can be used, the template cannot, or the folder holds something
        else.

    References
    ----------
    Cootes, Taylor, Cooper, Graham 1995, *Active shape models: their training and application*.
    Dryden, Mardia 2016, *Statistical shape analysis*.
    """
    collection = _collection(shapes)
    if len(collection.shapes) < FEWEST:
        raise InputError(
            f"An atlas needs {FEWEST} shapes or more; '{collection.name}' has "
            f"{len(collection.shapes)}."
        )
    if modes is not None and modes < 1:
        raise InputError(f"`modes` must be at least 1; got {modes}.")
    landmark_folder = _landmark_folder(shapes) if landmarks is None else Path(landmarks)
    if landmarks is not None:
        collection = with_landmarks(collection, landmarks)
    if registered:
        if folder is not None:
            _start_folder(Path(folder), {"template": "registered", "model": "none"}, renew=renew)
        found = _of_one_connectivity(collection, on_shape)
    else:
        with ExitStack() as stack:
            place = (
                stack.enter_context(shared_folder(workers))
                if folder is None
                else Path(folder).resolve()
            )
            model = model if isinstance(model, Model) else load_model(model)
            _start_folder(place, _settings(template, model, vertex_count), renew=renew)
            chosen, name = _template(
                template, collection, landmark_folder, place, vertex_count, workers, on_shape
            )
            meshes = place / _REGISTERED
            meshes.mkdir(exist_ok=True)
            records = registered_shapes(
                collection, chosen, meshes, model=model, workers=workers, on_shape=on_shape
            )
            vertices = {
                each.name: read_registered(meshes, each.name, chosen.mesh.faces)
                for each in records
                if not each.failure
            }
            found = _Registered(name, chosen.mesh, records, vertices)
    return _statistics(found, keep_size=keep_size, keep_failed=keep_failed, modes=modes)


def is_atlas_folder(folder: str | os.PathLike[str]) -> bool:
    """Whether a folder holds what an atlas consists of, whole or begun, and nothing else."""
    folder = Path(folder)
    return (
        folder.is_dir()
        and {path.name for path in folder.iterdir() if not path.name.startswith(UNFINISHED)} <= _OWN
    )


def _collection(shapes: Collection | str | os.PathLike[str] | Sequence[MeshLike]) -> Collection:
    if isinstance(shapes, Collection):
        collection = shapes
    elif isinstance(shapes, str | os.PathLike):
        # workers of a cluster may run in other folders
        exists = Path(shapes).exists()
        collection = open_collection(Path(shapes).resolve() if exists else shapes)
    else:
        width = len(str(max(len(shapes) - 1, 0)))
        named = [f"shape_{number:0{width}d}" for number in range(len(shapes))]
        collection = Collection(
            "shapes",
            tuple(
                Shape(name, name, f"only {name}", partial(as_mesh, mesh), partial(_vertices, mesh))
                for name, mesh in zip(named, shapes, strict=True)
            ),
        )
    if collection.store is not None:
        raise InputError(
            f"'{collection.store}' holds descriptors, no meshes; name the data set it was made of."
        )
    return collection


def _landmark_folder(shapes: object) -> Path | None:
    """The folder of landmarks that a data set has, if it is a folder that has one."""
    if not isinstance(shapes, str | os.PathLike):
        return None
    folder = Path(shapes) / "landmarks"
    return folder if folder.is_dir() else None


def _vertices(mesh: MeshLike) -> IntArray:
    return np.arange(len(as_mesh(mesh).vertices))


def _settings(template: MeshLike, model: Model, vertex_count: int) -> dict[str, Any]:
    """What an atlas of a folder must have in common with what is there."""
    if _is_auto(template):
        key = f"auto {vertex_count}"
    else:
        mesh = _given(template)
        key = content_key("mesh", mesh.vertices, mesh.faces)
    return {"template": key, "model": model_key(model)}


def _given(template: MeshLike) -> Mesh:
    """The template as it was given, with all its vertices."""
    mesh = usable_part(template)
    if not surface_area(mesh) > 0:
        raise InputError("The faces of the template have no area; a surface is needed.")
    return mesh


def _start_folder(folder: Path, settings: dict[str, Any], *, renew: bool) -> None:
    """Write the settings to a folder, or see that it holds the same."""
    path = folder / _SETTINGS_FILE
    try:
        folder.mkdir(parents=True, exist_ok=True)
        is_taken = not is_atlas_folder(folder)
    except OSError as error:
        raise InputError(f"'{folder}' cannot be written to: {error.strerror}.") from error
    if is_taken and not renew:
        raise InputError(f"'{folder}' holds other files and no atlas; choose an empty folder.")
    for place in (folder, folder / _REGISTERED):
        for left in place.glob(f"{UNFINISHED}*"):  # by a process that was killed
            if left.is_file():
                left.unlink(missing_ok=True)
    wanted = {"format": _FORMAT, **settings}
    if path.exists() and not renew:
        known = _known_settings(path)
        differing = [key for key in wanted if known.get(key) != wanted[key]]
        if differing:
            raise InputError(
                f"'{folder}' holds an atlas with another {' and '.join(differing)}; choose another "
                "folder, or give --force (`renew`) to replace it."
            )
        return
    _write_settings(path, wanted)


def _known_settings(path: Path) -> dict[str, Any]:
    try:
        known = json.loads(path.read_text(encoding="utf-8"))
        if not isinstance(known, dict):
            raise ValueError("it holds no object")
    except (OSError, ValueError) as error:
        raise InputError(
            f"'{path}' cannot be read: {error}. Choose another folder, or give --force (`renew`)."
        ) from error
    return known


def _write_settings(path: Path, settings: dict[str, Any]) -> None:
    with whole_file(path) as temporary:
        temporary.write_text(json.dumps(settings, indent=1), encoding="utf-8")


def _template(
    template: MeshLike,
    collection: Collection,
    landmarks: Path | None,
    folder: Path,
    vertex_count: int,
    workers: Workers,
    on_shape: Callable[[], None],
) -> tuple[Template, str]:
    """The template with its landmarks, and its name; a choice that was made before is kept."""
    path = folder / _TEMPLATE_FILE
    if not _is_auto(template):
        for _ in collection.shapes:
            on_shape()
        mesh = _given(template)
        name = Path(template).stem if isinstance(template, str | os.PathLike) else "template"
        write_mesh(mesh, path)
        return Template(mesh, _template_landmarks(name, mesh, collection, landmarks)), name
    settings = _known_settings(folder / _SETTINGS_FILE)
    name = settings.get("chosen", "")
    if name in {shape.name for shape in collection.shapes} and path.is_file():
        for _ in collection.shapes:
            on_shape()
        mesh = read_mesh(path)
    else:
        name = _middle(collection, workers, on_shape)
        chosen = collection[name].mesh()
        mesh = as_template(chosen, vertex_count=vertex_count, cache=default_cache())
        write_mesh(mesh, path)
        _write_settings(folder / _SETTINGS_FILE, {**settings, "chosen": name})
    return Template(mesh, _template_landmarks(name, mesh, collection, landmarks)), name


def _is_auto(template: MeshLike) -> bool:
    return isinstance(template, str) and template == "auto"


def _middle(collection: Collection, workers: Workers, on_shape: Callable[[], None]) -> str:
    """Name of the shape nearest to all others, by their spectra."""
    rows: dict[str, npt.NDArray[np.float64]] = {}
    failures = []
    for outcome in outcomes(_shape_dna, collection.shapes, workers=workers):
        if outcome.result is None:
            failures.append(outcome.failure_of(outcome.job.name))
        else:
            rows[outcome.job.name] = outcome.result
        on_shape()
    names = [shape.name for shape in collection.shapes if shape.name in rows]
    _check_enough(len(names), failures)
    return names[medoid([rows[each] for each in names])]


def _shape_dna(shape: Shape) -> npt.NDArray[np.float64]:
    return shape_dna(shape, cache=default_cache())


def _check_enough(count: int, reasons: Sequence[str]) -> None:
    if count < FEWEST:
        raise InputError(
            f"{count} of the shapes can be used; an atlas needs {FEWEST} or more. "
            f"{' '.join(reasons)}"
        )


def _template_landmarks(
    name: str, mesh: Mesh, collection: Collection, folder: Path | None
) -> Landmarks | None:
    """Landmarks of the template: in a folder by its name, or those of the shape that it is."""
    if not any(shape.landmarks for shape in collection.shapes):
        return None
    shape = next((each for each in collection.shapes if each.name == name), None)
    if shape is not None and shape.landmarks is not None:
        known, there = shape.landmarks(), shape.mesh()
        # the template may be a repaired or coarser copy of the shape: its nearest vertices
        near = KDTree(mesh.vertices).query(there.vertices[np.maximum(known.vertices, 0)])[1]
        return Landmarks(known.names, np.where(known.vertices >= 0, near, -1))
    file = None if folder is None else landmark_file(folder, name)
    if file is None:
        _log.warning("The template '%s' has no landmarks; those of the shapes are unused.", name)
        return None
    return read_landmarks(file, mesh)


@dataclass(frozen=True, slots=True, eq=False)
class _Registered:
    """What was registered: records of all shapes, and the vertices of those that did not fail."""

    template: str
    mesh: Mesh
    records: tuple[RegisteredShape, ...]
    vertices: dict[str, npt.NDArray[np.float64]]


def _of_one_connectivity(collection: Collection, on_shape: Callable[[], None]) -> _Registered:
    """Shapes that correspond already, by equal indices."""
    records: list[RegisteredShape] = []
    vertices: dict[str, npt.NDArray[np.float64]] = {}
    base, first = None, ""
    for shape in collection.shapes:
        failure = ""
        try:
            mesh = shape.mesh()
            if base is None:
                base, first = mesh, shape.name
            if np.array_equal(mesh.faces, base.faces) and len(mesh.vertices) == len(base.vertices):
                vertices[shape.name] = mesh.vertices
            else:
                failure = f"its connectivity is not that of '{first}'"
        except InputError as error:
            failure = str(error)
        share = 0.0 if failure else 1.0
        records.append(
            RegisteredShape(
                shape.name,
                shape.subject,
                distance=0.0,
                supported=share,
                covered=share,
                failure=failure,
            )
        )
        on_shape()
    _check_enough(
        len(vertices), [f"'{each.name}': {each.failure}." for each in records if each.failure]
    )
    assert base is not None  # of the first shape that could be read
    return _Registered(first, base, tuple(records), vertices)


def reason_to_leave_out(shape: RegisteredShape) -> str:
    """Why the registration of a shape is not to be trusted; empty if it is."""
    if shape.failure:
        return shape.failure
    if shape.verdict in ("failed", "mirrored"):
        return f"the map is {shape.verdict}"
    if not shape.distance <= _FAR:
        return f"the registered template is {shape.distance:.1%} of the extent off the shape"
    if not shape.covered >= _COVERED:
        return f"the registered template covers {shape.covered:.0%} of the shape"
    return ""


def _statistics(
    found: _Registered, *, keep_size: bool, keep_failed: bool, modes: int | None
) -> Atlas:
    """The statistics of what was registered."""
    left_out = {}
    for each in found.records:
        reason = each.failure if keep_failed else reason_to_leave_out(each)
        if not reason and not is_present(found.vertices[each.name]).any():
            reason = "it has no surface where the template lies"
        if reason:
            left_out[each.name] = reason
    if keep_size:
        kept = {name: each for name, each in found.vertices.items() if name not in left_out}
        left_out |= _of_another_unit(kept)
    used = [each for each in found.records if each.name not in left_out]
    _check_enough(len(used), [f"'{name}': {reason}." for name, reason in left_out.items()])
    base, mass = found.mesh, vertex_areas(found.mesh)
    vertices = np.stack([found.vertices[each.name] for each in used])
    # what hardly any shape has is left out of all: nothing could be said of its variation
    seen = is_present(vertices).sum(axis=0) >= _FEWEST_SEEN
    counted = np.where(seen[:, None], vertices, np.nan)
    mass = np.where(seen, mass, 0.0) / mass[seen].sum()
    start = np.where(seen[:, None], base.vertices, np.nan)
    aligned = generalised_procrustes(counted, mass=mass, start=start, keep_size=keep_size)
    whole = np.full_like(counted, np.nan)
    whole[:, seen] = completed(aligned.vertices[:, seen], mass=mass[seen])
    components = principal_components(
        whole, base.faces, mass=mass, count=modes, keep_size=keep_size
    )
    model = components.model
    everything = components if modes is None else principal_components(whole, base.faces, mass=mass)
    squares = ((aligned.vertices - model.mean) ** 2).sum(axis=2)
    present = np.isfinite(squares)
    distance = np.sqrt((np.where(present, squares, 0.0) @ mass) / (present @ mass))
    return Atlas(
        shapes=found.records,
        left_out=left_out,
        names=tuple(each.name for each in used),
        subjects=tuple(each.subject for each in used),
        faces=base.faces,
        vertices=vertices,
        aligned=aligned.vertices,
        sizes=aligned.sizes,
        scores=components.scores,
        distance=distance,
        is_outlier=outliers(distance),
        model=model,
        quality=model_quality(everything.scores, count=len(model.modes)),
        template=found.template,
    )


def _of_another_unit(vertices: dict[str, npt.NDArray[np.float64]]) -> dict[str, str]:
    """Shapes so much larger or smaller than the others that it is no size, and the reason."""
    sizes = {
        name: float(np.ptp(each[is_present(each)], axis=0).max()) for name, each in vertices.items()
    }
    middle = float(np.median(list(sizes.values()))) if sizes else 1.0
    return {
        name: f"it is {size / middle:.3g} times as large as usual; another unit of length? Convert "
        "it, or let sizes be removed"
        for name, size in sizes.items()
        if not 1 / _OTHER_UNIT < size / middle < _OTHER_UNIT
    }
