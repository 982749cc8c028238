"""Collections written to folders that other programs, and this one, can read."""

from __future__ import annotations

import csv
import os
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from esd.common import InputError, IntArray, whole_file
from esd.datasets.collection import Collection, Shape
from esd.mesh.io.meshes import WRITTEN_FORMATS, write_mesh
from esd.parallel import THIS_PROCESS, Workers, outcomes


def export_folder(
    collection: Collection,
    folder: str | os.PathLike[str],
    *,
    suffix: str = ".off",
    part_names: Sequence[str] = (),
    part_labels: IntArray | None = None,
    workers: Workers = THIS_PROCESS,
    on_shape: Callable[[], None] = lambda: None,
) -> None:
    """Write a collection in the layout that `esd.datasets.folder.folder_collection` reads.

    The folder is made where it does not exist. It gets `shapes/NAME.off`, `corres/NAME.vts` with
    the vertex, from 1 and 0 for none, at each point of the template, `corres/NAME.sym.vts` with the
    same under left-right symmetry where it is known, and `subjects.csv`. With part labels it gets
    `parts/names.txt` and `parts/NAME.txt` with the number, from 0, of each vertex's part.

    Parameters
    ----------
    suffix : str
        Format of the meshes, one of `esd.mesh.io.meshes.WRITTEN_FORMATS`.
    part_names
        Names of the parts, in the order of their labels.
    part_labels : (p,), optional
        Part of each point of the template.
    workers
        What makes and writes the shapes.
    on_shape
        Called after each shape, to show progress.

    Raises
    ------
    InputError
        If the suffix is unknown, a shape cannot be made, or the folder cannot be written to.
    """
    if suffix not in WRITTEN_FORMATS:
        raise InputError(f"`suffix` must be one of {', '.join(WRITTEN_FORMATS)}; got '{suffix}'.")
    folder = Path(folder)
    folders = ["shapes", "corres"] + ["parts"] * (part_labels is not None)
    try:
        for name in folders:
            (folder / name).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"'{folder}' cannot be written to: {error.strerror}.") from error
    write = partial(_write_shape, folder=folder, suffix=suffix, part_labels=part_labels)
    for outcome in outcomes(write, collection.shapes, workers=workers):
        if outcome.failure is not None:
            raise InputError(outcome.failure_of(outcome.job.name))
        on_shape()
    if part_labels is not None:
        _write_lines(part_names, folder / "parts" / "names.txt")
    with (
        whole_file(folder / "subjects.csv") as path,
        path.open("w", newline="", encoding="utf-8") as file,
    ):
        table = csv.writer(file)
        table.writerow(("name", "subject", "template"))
        table.writerows((s.name, s.subject, s.template) for s in collection.shapes)


def _write_shape(shape: Shape, *, folder: Path, suffix: str, part_labels: IntArray | None) -> None:
    """Write the files of one shape."""
    write_mesh(shape.mesh(), folder / "shapes" / f"{shape.name}{suffix}")
    _write_vts(shape.correspondence(), folder / "corres" / f"{shape.name}.vts")
    if shape.symmetric is not None:
        _write_vts(shape.symmetric(), folder / "corres" / f"{shape.name}.sym.vts")
    if part_labels is not None:
        labels = labels_on(shape, part_labels)
        _write_lines(labels.tolist(), folder / "parts" / f"{shape.name}.txt")


def labels_on(shape: Shape, labels: IntArray) -> IntArray:
    """Labels of the vertices of a shape, (n,), from those of the template's points, (p,).

    A vertex at which the template has no point takes the label of the nearest one that has.

    Raises
    ------
    InputError
        If there is not one label for each point of the template.
    """
    vertex = shape.correspondence()
    if labels.shape != vertex.shape:
        raise InputError(
            f"There must be a label for each of the {len(vertex)} points of the template of "
            f"'{shape.name}'; got shape {labels.shape}."
        )
    known = vertex >= 0
    vertices = shape.mesh().vertices
    nearest = cKDTree(vertices[vertex[known]]).query(vertices)[1]
    return np.asarray(labels[known][nearest])


def _write_vts(vertex: IntArray, path: Path) -> None:
    _write_lines((vertex + 1).tolist(), path)  # from 1; 0 for a point that the shape lacks


def _write_lines(values: Sequence[object], path: Path) -> None:
    with whole_file(path) as temporary:
        temporary.write_text("\n".join([*map(str, values), ""]), encoding="utf-8")
