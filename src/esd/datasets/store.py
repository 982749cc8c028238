"""Descriptors of a whole collection in one HDF5 file, which training maps and does not load."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import numpy.typing as npt

from esd.common import FloatArray, InputError, IntArray, whole_file
from esd.datasets.collection import Collection, Shape
from esd.datasets.hdf5 import check_self_contained
from esd.datasets.remeshing import copy_name
from esd.descriptors.recipe import Recipe
from esd.mesh.mesh import Mesh

_FORMAT = "esd-descriptors-1"
_TEXTS = ("names", "subjects", "templates", "keys")


@dataclass(frozen=True, slots=True, eq=False)
class StoredShape:
    """What a store holds of one shape; its arrays are read when they are asked for.

    Parameters
    ----------
    name, subject, template
        See `esd.datasets.collection.Shape`.
    key
        Of the content that all was computed from.
    vertices, points
        Number of its vertices, and of the points of its template.
    read
        Reads its descriptors at the vertices, (vertices, width) float32, and the vertex at each
        point of the template, (points,); -1 where it has none, or none with descriptors.
    """

    name: str
    subject: str
    template: str
    key: str
    vertices: int
    points: int
    read: Callable[[], tuple[npt.NDArray[np.float32], IntArray]]

    @property
    def identity(self) -> tuple[str, str, str, str]:
        """All that tells whether it is the same as another."""
        return self.name, self.subject, self.template, self.key


@dataclass(frozen=True, slots=True, eq=False)
class Store:
    """An open store; arrays that grow with the vertices are mapped, and read where they are used.

    Parameters
    ----------
    path
        Where it lies.
    collection
        Name of the collection.
    testing_subjects
        Of the collection.
    recipe
        Of the descriptors.
    remeshings
        Copies of each shape with other triangles that it holds too, see `with_remeshings`.
    names, subjects, templates, keys : for each shape
        In the order of the names.
    descriptors : (vertices of all shapes, width) float32
        The shapes one after another. The descriptors were rounded to it from float64: by at most
        6e-8 of their value.
    rows : (points of all shapes,) int64
        Row of `descriptors` at each point of each shape's template; -1 where it has none.
    vertex_start, point_start : (shapes + 1,) int64
        Where the shapes begin in `descriptors` and in `rows`.
    mean, variance : (shapes, width) float64
        Of the columns over the vertices of each shape.
    defined : (shapes,) int64
        Number of those vertices: those where all descriptors are finite.
    """

    path: Path
    collection: str
    testing_subjects: tuple[str, ...]
    recipe: Recipe
    remeshings: int
    names: tuple[str, ...]
    subjects: tuple[str, ...]
    templates: tuple[str, ...]
    keys: tuple[str, ...]
    descriptors: npt.NDArray[np.float32]
    rows: IntArray
    vertex_start: IntArray
    point_start: IntArray
    mean: FloatArray
    variance: FloatArray
    defined: IntArray

    def shapes(self) -> tuple[StoredShape, ...]:
        """All that is held, shape by shape."""
        vertices, points = np.diff(self.vertex_start).tolist(), np.diff(self.point_start).tolist()
        texts = zip(self.names, self.subjects, self.templates, self.keys, strict=True)
        return tuple(
            StoredShape(*text, vertices[place], points[place], partial(self.read, place))
            for place, text in enumerate(texts)
        )

    def read(self, place: int) -> tuple[npt.NDArray[np.float32], IntArray]:
        """Descriptors and correspondence of the shape at a place, as `StoredShape.read`."""
        first, last = self.vertex_start[place : place + 2]
        rows = self.rows_of(place)
        return self.descriptors[first:last], np.where(rows >= 0, rows - first, -1)

    def rows_of(self, place: int) -> IntArray:
        """Rows of the shape at a place, (points,).

        Raises
        ------
        InputError
            If they are no rows of it.
        """
        rows = self.rows[self.point_start[place] : self.point_start[place + 1]]
        first, last = self.vertex_start[place : place + 2]
        if not ((rows == -1) | ((rows >= first) & (rows < last))).all():
            raise InputError(
                f"The store '{self.path}' is damaged; make it anew: points of "
                f"'{self.names[place]}' are at rows that it does not have."
            )
        return rows

    def moments(self, places: Sequence[int]) -> tuple[FloatArray, FloatArray]:
        """Mean and variance of each column, (width,) each, over the vertices of some shapes."""
        weight = self.defined[places] / self.defined[places].sum()
        means = self.mean[places]
        mean = weight @ means
        return mean, weight @ (self.variance[places] + (means - mean) ** 2)


def is_store(path: str | os.PathLike[str]) -> bool:
    """Whether a path is a store, whatever its name says."""
    path = Path(path)
    if not (path.is_file() and h5py.is_hdf5(path)):
        return False
    try:
        with h5py.File(path, "r") as file:
            return bool(file.attrs.get("format") == _FORMAT)
    except (OSError, KeyError, TypeError, ValueError, RuntimeError):  # of damaged files
        return False


def open_store(path: str | os.PathLike[str]) -> Store:
    """The store in a file.

    Raises
    ------
    InputError
        If the file is none, or damaged.
    """
    path = Path(path)
    if not is_store(path):
        raise InputError(f"'{path}' is no store of descriptors; make one by `esd precompute`.")
    try:
        with h5py.File(path, "r") as file:
            check_self_contained(file)
            texts = {name: tuple(file[name].asstr()[:].tolist()) for name in _TEXTS}
            store = Store(
                path=path,
                collection=str(file.attrs["collection"]),
                testing_subjects=tuple(json.loads(file.attrs["testing_subjects"])),
                recipe=Recipe.from_json(json.loads(file.attrs["recipe"])),
                remeshings=int(file.attrs["remeshings"]),
                **texts,
                descriptors=_mapped(file["descriptors"], np.float32, 2),
                rows=_mapped(file["rows"], np.int64, 1),
                vertex_start=file["vertex_start"][:],
                point_start=file["point_start"][:],
                mean=_mapped(file["mean"], np.float64, 2),
                variance=_mapped(file["variance"], np.float64, 2),
                defined=file["defined"][:],
            )
    except (KeyError, TypeError, ValueError, OSError, AttributeError, RuntimeError) as error:
        raise InputError(f"The store '{path}' is damaged; make it anew: {error}.") from error
    count, width = len(store.names), store.recipe.width
    fits = (
        all(len(text) == count for text in texts.values())
        and len(store.defined) == count > 0
        and store.mean.shape == store.variance.shape == (count, width)
        and _is_partition(store.vertex_start, count, len(store.descriptors))
        and _is_partition(store.point_start, count, len(store.rows))
        and store.descriptors.shape[1] == width
    )
    if not fits:
        raise InputError(f"The store '{path}' is damaged; make it anew: its parts do not fit.")
    return store


def save_store(
    path: str | os.PathLike[str],
    shapes: Sequence[StoredShape],
    *,
    collection: Collection,
    recipe: Recipe,
    remeshings: int,
) -> None:
    """Write a store whole; shapes are read one at a time.

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    starts = np.zeros((len(shapes) + 1, 2), dtype=np.int64)
    starts[1:] = np.cumsum([(shape.vertices, shape.points) for shape in shapes], axis=0)
    with whole_file(path) as temporary, h5py.File(temporary, "w") as file:
        file.attrs["format"] = _FORMAT
        file.attrs["collection"] = collection.name
        file.attrs["testing_subjects"] = json.dumps(collection.testing_subjects)
        file.attrs["recipe"] = json.dumps(recipe.to_json())
        file.attrs["remeshings"] = remeshings
        file["vertex_start"], file["point_start"] = starts.T
        # contiguous and not in chunks: points drawn at random are then single pages of a mapping
        descriptors = file.create_dataset("descriptors", (starts[-1, 0], recipe.width), "<f4")
        rows = file.create_dataset("rows", (starts[-1, 1],), "<i8")
        mean, variance = (
            file.create_dataset(name, (len(shapes), recipe.width), "<f8")
            for name in ("mean", "variance")
        )
        defined = file.create_dataset("defined", (len(shapes),), "<i8")
        for place, shape in enumerate(shapes):
            (first, first_point), (last, last_point) = starts[place : place + 2]
            values, index = shape.read()
            descriptors[first:last] = values
            rows[first_point:last_point] = np.where(index >= 0, index + first, -1)
            finite = values[np.isfinite(values).all(axis=1)].astype(np.float64)
            defined[place] = len(finite)
            if len(finite):
                mean[place], variance[place] = finite.mean(axis=0), finite.var(axis=0)
        columns = zip(*(shape.identity for shape in shapes), strict=True)
        for name, column in zip(_TEXTS, columns, strict=True):
            file.create_dataset(name, data=column, dtype=h5py.string_dtype())


def store_collection(path: str | os.PathLike[str]) -> Collection:
    """The collection of a store: names, subjects, templates and correspondences, but no meshes.

    Copies with other triangles are no shapes of it; training takes them along.

    Raises
    ------
    InputError
        If the file is no store, or damaged.
    """
    store = open_store(path)
    copies = {copy_name(name, i) for name in store.names for i in range(store.remeshings)}
    shapes = tuple(
        Shape(
            name,
            store.subjects[place],
            store.templates[place],
            mesh=partial(_no_mesh, store.path),
            correspondence=partial(_correspondence, store, place),
        )
        for place, name in enumerate(store.names)
        if name not in copies
    )
    return Collection(store.collection, shapes, store.testing_subjects, store=store.path)


def _correspondence(store: Store, place: int) -> IntArray:
    return store.read(place)[1]


def _no_mesh(path: Path) -> Mesh:
    raise InputError(f"The store '{path}' holds no meshes; name the data set it was made of.")


def _mapped(dataset: Any, dtype: type, dimensions: int) -> npt.NDArray[Any]:
    """The array of a contiguous dataset, mapped into memory: read where it is used."""
    offset = dataset.id.get_offset()
    if dataset.dtype != dtype or dataset.ndim != dimensions or offset is None:
        raise ValueError(f"'{dataset.name}' is not as it was written")
    return np.memmap(dataset.file.filename, dtype, "r", offset, dataset.shape)


def _is_partition(starts: IntArray, count: int, size: int) -> bool:
    """Whether `starts` cuts `size` rows into `count` parts."""
    ends = len(starts) == count + 1 and starts[0] == 0 and starts[-1] == size
    return bool(ends and (np.diff(starts) >= 0).all())
