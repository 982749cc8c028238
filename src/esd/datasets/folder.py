"""Collections in folders: of one connectivity, with `.vts` correspondences, or without any."""

from __future__ import annotations

import csv
import logging
import os
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import numpy.typing as npt

from esd.common import InputError, IntArray, reason, table_rows
from esd.datasets.collection import Collection, Shape
from esd.mesh.io.landmarks import Landmarks, read_landmarks
from esd.mesh.io.meshes import FORMATS, read_arrays
from esd.mesh.mesh import Mesh
from esd.spectral.cache import content_key

_log = logging.getLogger(__name__)

_SUBJECT_PATTERNS = (
    r"tr_reg_(\d+)\d",  # FAUST: the last digit is the pose
    r"(5\d{4})_.+",  # Dyna, D-FAUST: subject_sequence
    r"(s\d+)_p\d+",  # bodies
)
_COMPARED = 64  # meshes of a folder whose connectivities are compared when it is opened
_TOSCA = "cat|centaur|david|dog|gorilla|horse|lioness|michael|seahorse|victoria|wolf"


def folder_collection(path: str | os.PathLike[str]) -> Collection:
    """The collection in a folder.

    The meshes lie in the folder or in `shapes/` within it. Where there is a folder `corres` (or
    `corr`), its `NAME.vts` holds the 1-based vertex of shape NAME at each point of the template,
    one a line, 0 where the shape lacks the point, and `NAME.sym.vts` the same under left-right
    symmetry. Where there is no such folder and all meshes have one connectivity, equal indices
    correspond; of large folders each mesh is checked when it is read, so that opening one takes no
    time. Shapes of several connectivities correspond with no other: each is its own template.

    Subjects follow from the names of FAUST, Dyna and D-FAUST, and where all shapes have names of
    TOSCA, so do the classes, which do not correspond with each other; elsewhere each shape is a
    subject of its own. A file `subjects.csv` with the columns `name,subject` and, if shapes of
    several kinds do not correspond with each other, `template`, overrides that.

    `parts/names.txt` may hold the names of the parts of the body, and `parts/NAME.txt`, for one or
    more of the shapes, the number, from 0, of the part of each vertex, one a line.

    `landmarks/NAME.csv` may hold the landmarks of a shape, see
    `esd.mesh.io.landmarks.read_landmarks`.

    Raises
    ------
    InputError
        If there is no collection in the folder.
    """
    folder = Path(path)
    if not folder.is_dir():
        raise InputError(f"There is no data set '{folder}': expected a folder of shapes.")
    shapes_folder = folder / "shapes" if (folder / "shapes").is_dir() else folder
    files = sorted(
        file
        for file in shapes_folder.iterdir()
        # macOS leaves a hidden '._NAME' beside each file on other systems' disks
        if file.suffix.lower() in FORMATS and not file.name.startswith(".")
    )
    if not files:
        raise InputError(f"There is no mesh in '{shapes_folder}' ({', '.join(FORMATS)}).")
    names = [file.stem for file in files]
    if len(set(names)) != len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise InputError(f"'{shapes_folder}' has several meshes named '{twice}'.")
    identities = _identities(names, _listed_subjects(folder / "subjects.csv", names))
    for name in ("corres", "corr"):
        if (folder / name).is_dir():
            shapes = _with_correspondences(files, folder / name, identities)
            break
    else:
        shapes = _without_correspondences(folder, files, identities)
    by_name = {file.stem: file for file in files}
    shapes = [_with_landmarks(shape, by_name[shape.name], folder) for shape in shapes]
    return Collection(folder.resolve().name, tuple(shapes))


def read_vts(path: str | os.PathLike[str]) -> IntArray:
    """Vertex indices from 0 in a `.vts` file, which holds one index from 1 a line.

    0 in the file, -1 here, is a point that the shape lacks.

    Raises
    ------
    InputError
        If the file is missing, holds anything but such integers, or no vertex at all.
    """
    path = Path(path)
    try:
        index = np.array(path.read_text(encoding="ascii").split(), dtype=np.int64)
    except FileNotFoundError:
        raise InputError(f"There is no correspondence '{path}'.") from None
    except (ValueError, UnicodeDecodeError, OverflowError) as error:
        raise InputError(f"'{path}' must hold one vertex index a line: {reason(error)}.") from error
    if len(index) == 0:
        raise InputError(f"'{path}' is empty.")
    if index.min() < 0:
        raise InputError(
            f"'{path}' holds {index.min()}; .vts files count vertices from 1, 0 for none."
        )
    if index.max() < 1:
        raise InputError(f"'{path}' names no vertex: all of its lines are 0.")
    return index - 1


def read_parts(folder: Path, name: str, points: Callable[[], IntArray]) -> npt.NDArray[np.str_]:
    """Names of the parts of the body at the points of the template, (p,), from a shape's labels.

    Parameters
    ----------
    folder
        Of `names.txt` and the labels of shapes.
    name
        Of the shape.
    points
        Reads its vertex at each point, (p,); -1 for none, where the name is empty.

    Raises
    ------
    InputError
        If a file is missing, or they do not fit each other or the vertices.
    """
    try:
        names = [*(folder / "names.txt").read_text(encoding="utf-8").splitlines(), ""]
        labels = np.array((folder / f"{name}.txt").read_text("ascii").split(), dtype=np.int64)
    except (OSError, ValueError, OverflowError) as error:
        raise InputError(
            f"The parts of '{name}' cannot be read: expected a number a line in '{name}.txt', and "
            f"names in 'names.txt' of '{folder}'; got: {error}."
        ) from error
    vertex = points()
    if not ((labels >= 0) & (labels < len(names) - 1)).all() or vertex.max() >= len(labels):
        raise InputError(
            f"'{folder / name}.txt' must hold a number from 0 to {len(names) - 2}, of the names in "
            f"'names.txt', for each vertex; the points lie on {vertex.max() + 1} or more."
        )
    return np.array(names)[np.where(vertex >= 0, labels[vertex], -1)]


def _parts(
    folder: Path, name: str, points: Callable[[], IntArray]
) -> Callable[[], npt.NDArray[np.str_]] | None:
    """What reads the parts of a shape, if the data set has them."""
    if not (folder / "parts" / f"{name}.txt").is_file():
        return None
    return partial(read_parts, folder / "parts", name, points)


def _with_correspondences(
    files: list[Path], corres: Path, identities: Mapping[str, tuple[str, str]]
) -> list[Shape]:
    """Shapes with what a folder of `.vts` files says; those that it lacks are logged."""
    lacking = {file.name for file in files if not (corres / f"{file.stem}.vts").is_file()}
    if len(lacking) == len(files):
        raise InputError(f"The shape '{files[0].name}' has no correspondence in '{corres}'.")
    if lacking:
        _log.warning(
            "%d of %d shapes have no correspondence in '%s', and correspond with no other: %s.",
            len(lacking),
            len(files),
            corres,
            ", ".join(sorted(lacking)),
        )
    found = [file for file in files if file.name not in lacking]
    templates = {file: identities[file.stem][1] for file in found}
    # the first shape of each template says how many points the others must have
    lengths: dict[str, tuple[Path, int]] = {}
    for file in found:
        vts = corres / f"{file.stem}.vts"
        if templates[file] not in lengths:
            lengths[templates[file]] = vts, len(read_vts(vts))
    shapes = [
        _alone(file, identities)
        if file.name in lacking
        else _with_vts(file, corres, identities, *lengths[templates[file]])
        for file in files
    ]
    compared = np.unique(np.linspace(0, len(found) - 1, num=_COMPARED).round().astype(int))
    for i in compared:  # the others are checked when they are read
        vts = corres / f"{found[i].stem}.vts"
        _read_points(vts, *lengths[templates[found[i]]])
    return shapes


def _alone(file: Path, identities: Mapping[str, tuple[str, str]]) -> Shape:
    """A shape that corresponds with no other: its template is its own mesh."""
    return Shape(
        name=file.stem,
        subject=identities[file.stem][0],
        template=f"only {file.stem}",
        mesh=partial(_read_shape, file),
        correspondence=partial(_all_vertices, file),
    )


def _all_vertices(file: Path) -> IntArray:
    return np.arange(len(_read_shape(file).vertices))


def _with_landmarks(shape: Shape, file: Path, folder: Path) -> Shape:
    """A shape with its landmarks, if the data set has them."""
    landmarks = folder / "landmarks" / f"{shape.name}.csv"
    if not landmarks.is_file():
        return shape
    return replace(shape, landmarks=partial(_landmarks, file, landmarks))


def _landmarks(file: Path, landmarks: Path) -> Landmarks:
    return read_landmarks(landmarks, _read_shape(file))


def _read_points(vts: Path, first: Path, count: int) -> IntArray:
    """Vertex indices in a `.vts` file, of as many points as the first of its template has."""
    index = read_vts(vts)
    if len(index) != count:
        raise InputError(
            f"'{vts}' has {len(index)} points and '{first}' {count}: shapes that correspond have "
            "equally many lines, with 0 for a point that one lacks. Of shapes that do not, list "
            "their templates in 'subjects.csv' (name,subject,template)."
        )
    return index


def _with_vts(
    file: Path,
    corres: Path,
    identities: Mapping[str, tuple[str, str]],
    first: Path,
    count: int,
) -> Shape:
    """A shape with the correspondence in its `.vts` file.

    Parameters
    ----------
    first, count
        A `.vts` file of the same template, and how many points it has.
    """
    vts = corres / f"{file.stem}.vts"
    mirrored = corres / f"{file.stem}.sym.vts"
    subject, template = identities[file.stem]
    points = partial(_read_points, vts, first, count)
    return Shape(
        name=file.stem,
        subject=subject,
        template=template,
        mesh=partial(_read_shape, file),
        correspondence=points,
        symmetric=partial(_read_points, mirrored, first, count) if mirrored.is_file() else None,
        parts=_parts(corres.parent, file.stem, points),
    )


def _without_correspondences(
    folder: Path, files: list[Path], identities: Mapping[str, tuple[str, str]]
) -> list[Shape]:
    """Shapes of one connectivity, or such that correspond with no other."""
    place, first = _first_readable(files)
    connectivity = first.connectivity
    compared = np.unique(np.linspace(0, len(files) - 1, num=_COMPARED).round().astype(int))[1:]
    if not all(_has_connectivity(files[i], connectivity) for i in compared[::-1]):
        return [_alone(file, identities) for file in files]
    shapes = []
    for file in files:
        subject, template = identities[file.stem]
        everywhere = partial(np.arange, len(first.mesh.vertices))
        parts = _parts(folder, file.stem, everywhere)
        shapes.append(
            Shape(
                name=file.stem,
                subject=subject,
                template=template,
                mesh=partial(_read_alike, file, files[place].name, connectivity),
                correspondence=everywhere,
                parts=parts,
            )
        )
    return shapes


@dataclass(frozen=True, slots=True, eq=False)
class _Read:
    """A mesh, and a key of the connectivity that its file has."""

    mesh: Mesh
    connectivity: str


def _read(file: Path) -> _Read:
    """The mesh in a file, without the faces at vertices that are not finite."""
    vertices, faces = read_arrays(file)
    finite = np.isfinite(vertices).all(axis=1)
    try:
        mesh = Mesh(np.where(finite[:, None], vertices, 0.0), faces)
    except InputError as error:
        raise InputError(f"'{file}': {error}") from error
    key = content_key("connectivity", mesh.faces, vertices=len(mesh.vertices))
    if not finite.all():
        middle = vertices[finite].mean(axis=0) if finite.any() else np.zeros(3)
        used = finite[mesh.faces].all(axis=1)
        _log.warning(
            "'%s': coordinates that are not finite at %d of its vertices; these and their %d faces "
            "are left out.",
            file,
            np.sum(~finite),
            np.sum(~used),
        )
        mesh = Mesh(np.where(finite[:, None], vertices, middle), mesh.faces[used])
    return _Read(mesh, key)


def _read_shape(file: Path) -> Mesh:
    return _read(file).mesh


def _first_readable(files: list[Path]) -> tuple[int, _Read]:
    """The place of the first mesh that can be read, and what was read."""
    for place, file in enumerate(files[:-1]):
        if found := _readable(file):
            return place, found
    return len(files) - 1, _read(files[-1])


def _has_connectivity(file: Path, connectivity: str) -> bool:
    """Whether a mesh has a connectivity; one that cannot be read is reported when it is used."""
    found = _readable(file)
    return found is None or found.connectivity == connectivity


def _readable(file: Path) -> _Read | None:
    try:
        return _read(file)
    except InputError:
        return None


def _read_alike(file: Path, first: str, connectivity: str) -> Mesh:
    """The mesh in a file, if it has the connectivity of the first one."""
    found = _read(file)
    if found.connectivity != connectivity:
        raise InputError(
            f"'{file.name}' has another connectivity than '{first}', unlike most in its folder: "
            "remove it, or put correspondences of all into 'corres/NAME.vts'."
        )
    return found.mesh


def _identities(
    names: Sequence[str], listed: Mapping[str, tuple[str, str | None]]
) -> dict[str, tuple[str, str]]:
    """Subject and template of each shape by name."""
    found = {name: re.fullmatch(rf"({_TOSCA})\d+", name) for name in names if name not in listed}
    # a 'dog2' beside a 'cow_alph4' is not TOSCA's
    tosca = {name: match[1] for name, match in found.items() if match is not None}
    if len(tosca) < len(found):
        tosca = {}
    result = {}
    for name in names:
        if name in listed:
            subject, template = listed[name]
            result[name] = subject, template or "template"
        elif name in tosca:
            result[name] = tosca[name], tosca[name]
        else:
            matches = (re.fullmatch(pattern, name) for pattern in _SUBJECT_PATTERNS)
            result[name] = next((match[1] for match in matches if match), name), "template"
    return result


def _listed_subjects(path: Path, names: Sequence[str]) -> dict[str, tuple[str, str | None]]:
    """Subject and template, if any, of the shapes in a file, which must be among those there are.

    A name that is misspelled would leave its shape with a subject of its own, and so the shapes of
    one subject on both sides of a split.
    """
    if not path.is_file():
        return {}
    try:
        columns, rows = table_rows(path.read_text(encoding="utf-8-sig"))
        listed = list(rows)
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"'{path}' must be a CSV file in UTF-8: {error}.") from error
    if not {"name", "subject"} <= columns:
        raise InputError(f"'{path}' must have the columns name,subject (and template).")
    for number, row in listed:
        if not row["name"] or not row["subject"]:
            raise InputError(f"'{path}', line {number}: expected a name and a subject.")
    unknown = sorted({row["name"] for _, row in listed} - set(names))
    if unknown:
        some = ", ".join(unknown[:5]) + (", …" if len(unknown) > 5 else "")
        raise InputError(
            f"'{path}' names shapes that do not exist ({len(unknown)}): {some}. Expected names of "
            f"files without their suffix, such as '{names[0]}'."
        )
    return {row["name"]: (row["subject"], row.get("template")) for _, row in listed}
