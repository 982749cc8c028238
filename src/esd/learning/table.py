"""Training data in memory: descriptors of many shapes, and which rows are one point."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain

import numpy as np
import numpy.typing as npt

from esd.common import FloatArray, InputError, IntArray
from esd.datasets.collection import Collection, Shape, repaired_shape
from esd.datasets.remeshing import copy_name
from esd.datasets.store import open_store
from esd.descriptors.recipe import Recipe, recipe_spectrum, spectrum_descriptors
from esd.learning.model import standardised
from esd.learning.patches import Patches, patch_operator
from esd.mesh.mesh import Mesh
from esd.parallel import THIS_PROCESS, Workers, outcomes
from esd.spectral.cache import Cache
from esd.spectral.laplacian import SparseMatrix

_CHUNK = 2**14  # rows
_LARGEST_HALF = 30_000.0  # deviations; numbers of 16 bits end at twice this


@dataclass(frozen=True, slots=True, eq=False)
class Standardisation:
    """What `esd.learning.model.standardised` does to descriptors, for its parameters."""

    mean: FloatArray
    deviation: FloatArray
    limit: float | None

    def __call__(self, values: FloatArray) -> FloatArray:
        """Standardised descriptors."""
        return standardised(values, self.mean, self.deviation, limit=self.limit)


@dataclass(frozen=True, slots=True, eq=False)
class PointTable:
    """Descriptors of all shapes of a collection at the points of their templates.

    Parameters
    ----------
    values : (vertices of all shapes, width) float32 or float16
        Descriptors, the shapes one after another.
    rows : for each shape (points,) int64
        Row of `values` at each point of the shape's template; -1 where it has none.
    templates : (shapes,) int64
        Number of the template of each shape.
    stored
        Of a table in a store, whose `values` and `rows` are read from the file when they are used:
        what is not.
    operators : for each shape (vertices · bins, vertices)
        Of `esd.learning.patches.patch_operator`; none where nothing is convolved.
    rough
        By what values of 16 bits were standardised as they came, by the moments of one shape;
        theirs, which are finer than a thousandth of a deviation, are known at the end only.
    """

    values: npt.NDArray[np.float32] | npt.NDArray[np.float16]
    rows: tuple[IntArray, ...]
    templates: IntArray
    stored: Stored | None = None
    operators: tuple[SparseMatrix, ...] = ()
    rough: Standardisation | None = None

    def at(self, rows: IntArray) -> npt.NDArray[np.float32]:
        """Descriptors at some rows, (r, width)."""
        values = self.values[rows].astype(np.float32, copy=False)
        if self.stored is None or self.stored.standardisation is None:
            return values
        return self.stored.standardisation(values).astype(np.float32)

    def shapes(self) -> list[npt.NDArray[np.float32]]:
        """Descriptors (vertices, width) of each shape that has an operator."""
        stops = np.cumsum([operator.shape[1] for operator in self.operators])
        return np.split(self.values, stops[:-1])

    def whole_shape(self, rows: IntArray) -> WholeShape:
        """The shape that some rows are of, all of one, with its operator."""
        stops = np.cumsum([operator.shape[1] for operator in self.operators])
        place = int(np.searchsorted(stops, rows[0], side="right"))
        operator = self.operators[place]
        start = int(stops[place]) - operator.shape[1]
        values = self.values[start : stops[place]].astype(np.float32, copy=False)
        values = np.nan_to_num(values)  # no patch takes the undefined
        return WholeShape(values, operator, rows - start)

    def standardised(
        self,
        mean: FloatArray,
        deviation: FloatArray,
        *,
        limit: float | None = None,
        in_place: bool = False,
    ) -> PointTable:
        """The table with its values as `esd.learning.model.standardised` makes them.

        In place, they overwrite those of this table, which must not be used any more: two tables
        may be more than memory holds.
        """
        change = Standardisation(mean, deviation, limit)
        if self.stored is not None:
            return replace(self, stored=replace(self.stored, standardisation=change))
        if self.rough is not None:  # what is left to do after the rough one
            first = self.rough
            change = Standardisation(
                (mean - first.mean) / first.deviation, deviation / first.deviation, limit
            )
        values = self.values if in_place else np.empty_like(self.values)
        for start in range(0, len(values), _CHUNK):  # float64 of all at once may be too much
            part = slice(start, start + _CHUNK)
            values[part] = change(self.values[part])
        return replace(self, values=values, rough=None)


@dataclass(frozen=True, slots=True, eq=False)
class WholeShape:
    """Some vertices of a shape, and what a convolution around them takes.

    Parameters
    ----------
    values : (n, width) float32
        Descriptors of all its vertices.
    operator : (n · bins, n)
        See `esd.learning.patches.patch_operator`.
    vertices : (b,)
        Those that are asked for.
    """

    values: npt.NDArray[np.float32]
    operator: SparseMatrix
    vertices: IntArray


@dataclass(frozen=True, slots=True, eq=False)
class Stored:
    """What is in memory of a `PointTable` in a store.

    Parameters
    ----------
    keys
        Of the content of each shape.
    mean, deviation : (width,)
        Of the columns of its values, as they are in the file, over its shapes.
    standardisation
        Of the values when they are read.
    """

    keys: tuple[str, ...]
    mean: FloatArray
    deviation: FloatArray
    standardisation: Standardisation | None = None


def point_table(
    collection: Collection,
    recipe: Recipe,
    *,
    points: int | None = None,
    half: bool = False,
    patches: Patches | None = None,
    workers: Workers = THIS_PROCESS,
    cache: Cache | None = None,
    on_shape: Callable[[], None] = lambda: None,
) -> PointTable:
    """Descriptors and correspondences of a collection.

    Parameters
    ----------
    points
        Number of points of each template to keep, drawn at random but the same for all its shapes,
        with no other vertices, so that many shapes fit into memory; all by default.
    half
        Whether values are in 16 bits, as far as they are to be standardised: half the memory.
    patches
        Of which operators are computed as well. They need all vertices, so `points` must be None.
    workers
        What describes the shapes.
    on_shape
        Called after each shape, to show progress.

    Raises
    ------
    InputError
        If a shape cannot be read or described, or points outside its mesh.
    """
    if collection.store is not None:
        raise InputError(f"'{collection.store}' is a store; see `stored_table`.")
    describe = partial(
        _described, recipe=recipe, points=points, half=half, patches=patches, cache=cache
    )
    found: list[_Described | None] = [None] * len(collection.shapes)
    # filled as shapes arrive: joined at the end, the table would be in memory twice
    room = 0 if points is None else points
    space = np.empty((len(found) * room, recipe.width), dtype=np.float16 if half else np.float32)
    rough = None
    jobs = list(enumerate(collection.shapes))
    first = outcomes(describe, jobs[: int(half)], workers=THIS_PROCESS)
    for outcome in chain(first, outcomes(describe, jobs[int(half) :], workers=workers)):
        place, shape = outcome.job
        if outcome.result is None:
            raise InputError(outcome.failure_of(shape.name))
        described = outcome.result
        if half:
            # by the moments of the first shape, whatever the order in which the others are done
            rough = rough or _rough(described.values)
            values = np.clip(rough(described.values), -_LARGEST_HALF, _LARGEST_HALF)
            described = replace(described, values=values.astype(np.float16))
        if len(described.values) <= room:
            part = space[place * room :][: len(described.values)]
            part[:] = described.values
            described = replace(described, values=part)
        found[place] = described
        on_shape()
    templates = _numbered([shape.template for shape in collection.shapes])
    return replace(_joined(found, templates, space), rough=rough)


def _rough(values: FloatArray) -> Standardisation:
    """Of the descriptors (n, width) of one shape, which stand for those of all."""
    known = values[np.isfinite(values).all(axis=1)].astype(np.float64)
    deviation = known.std(axis=0)
    return Standardisation(known.mean(axis=0), np.where(deviation > 0, deviation, 1.0), None)


@dataclass(frozen=True, slots=True, eq=False)
class _Described:
    """What a `PointTable` has of one shape, its rows counted from its first.

    Parameters
    ----------
    values : (vertices, width) float32 or float16
    rows : (points,)
        -1 for none.
    operator : (vertices · bins, vertices)
        Where something is convolved.
    """

    values: npt.NDArray[np.float32] | npt.NDArray[np.float16]
    rows: IntArray
    operator: SparseMatrix | None


def _described(
    job: tuple[int, Shape],
    *,
    recipe: Recipe,
    points: int | None,
    half: bool,
    patches: Patches | None,
    cache: Cache | None,
) -> _Described:
    """Descriptors of one shape, of a place in its collection, at its points."""
    _, shape = job
    repaired, index, _ = repaired_shape(shape)
    mesh = repaired.shape
    assert isinstance(mesh, Mesh)
    spectrum = recipe_spectrum(recipe, mesh, cache=cache)
    columns = spectrum_descriptors(recipe, mesh, spectrum, single=half)
    operator = None if patches is None else patch_operator(patches, mesh, cache=cache)
    if points is not None and points < len(index):
        # the same points of the template on all of its shapes
        index = index[np.sort(np.random.default_rng(0).permutation(len(index))[:points])]
        vertices, index = np.unique(index, return_inverse=True)
        if vertices[0] == -1:  # sorted first: the points that this shape lacks
            vertices, index = vertices[1:], index - 1
        columns = columns[vertices]
    defined = np.isfinite(columns[index]).all(axis=1)
    rows = np.where((index >= 0) & defined, index, -1)
    return _Described(columns.astype(np.float32, copy=False), rows, operator)


def _joined(
    found: list[_Described | None],
    templates: IntArray,
    space: npt.NDArray[np.float32] | npt.NDArray[np.float16],
) -> PointTable:
    """The table of all shapes, which are taken from the list.

    Parameters
    ----------
    space
        What the table takes if it has rows enough: then the values lie in it already, those of
        each shape at its place or after it, and move together.
    """
    sizes = [0 if each is None else len(each.values) for each in found]
    stops = np.cumsum(sizes)
    room = len(space) // len(found)
    fits = max(sizes) <= room
    values = space if fits else np.empty((stops[-1], space.shape[1]), dtype=space.dtype)
    rows, operators = [], []
    for place, (stop, size) in enumerate(zip(stops.tolist(), sizes, strict=True)):
        each, found[place] = found[place], None
        assert each is not None
        values[stop - size : stop] = each.values
        rows.append(np.where(each.rows >= 0, each.rows + stop - size, -1))
        if each.operator is not None:
            operators.append(each.operator)
    return PointTable(values[: stops[-1]], tuple(rows), templates, operators=tuple(operators))


def stored_table(collection: Collection, recipe: Recipe, *, copies: int = 0) -> PointTable:
    """The table of a collection in a store, of which a row is read when it is drawn.

    Parameters
    ----------
    copies
        Copies of each shape with other triangles that belong to it as well; those that could not
        be computed are left out.

    Raises
    ------
    InputError
        If the store lacks such copies, or is of another recipe.
    """
    assert collection.store is not None
    store = open_store(collection.store)
    if store.recipe.to_json() != recipe.to_json() or store.remeshings < copies:
        raise InputError(
            f"'{store.path}' does not hold what this training takes: its descriptors are of "
            "another recipe, or without its copies of other triangles. Make another by "
            "`esd precompute` with the preset of the training."
        )
    place = {name: i for i, name in enumerate(store.names)}
    names = [shape.name for shape in collection.shapes]
    names += [copy_name(name, i) for name in names for i in range(copies)]
    chosen = [place[name] for name in names if name in place]
    mean, variance = store.moments(chosen)
    deviation = np.where(variance > 0, np.sqrt(variance), 1.0)
    return PointTable(
        store.descriptors,
        tuple(store.rows_of(i) for i in chosen),
        _numbered([store.templates[i] for i in chosen]),
        Stored(tuple(store.keys[i] for i in chosen), mean, deviation),
    )


def _numbered(templates: list[str]) -> IntArray:
    return np.asarray(np.unique(templates, return_inverse=True)[1], dtype=np.int64)


def standardisation(table: PointTable, *, wanted: bool = True) -> tuple[FloatArray, FloatArray]:
    """Mean and standard deviation of each column, (width,) each, over all vertices of all shapes.

    Columns that never vary have deviation one. Unless it is wanted, zeros and ones, which change
    nothing.
    """
    if not wanted:
        width = table.values.shape[1]
        return np.zeros(width), np.ones(width)
    if table.stored is not None:
        return table.stored.mean, table.stored.deviation
    # part by part, in float64: a copy of all may be more than memory holds
    parts = [table.values[i : i + _CHUNK] for i in range(0, len(table.values), _CHUNK)]
    defined = [np.isfinite(part).all(axis=1) for part in parts]
    count = sum(int(each.sum()) for each in defined)
    mean, variance = np.zeros(table.values.shape[1]), np.zeros(table.values.shape[1])
    for part, known in zip(parts, defined, strict=True):
        mean += part[known].sum(axis=0, dtype=np.float64) / count
    for part, known in zip(parts, defined, strict=True):
        variance += ((part[known] - mean) ** 2).sum(axis=0) / count
    deviation = np.sqrt(variance)
    deviation = np.where(deviation > 0, deviation, 1.0)
    if table.rough is None:
        return mean, deviation
    return table.rough.mean + table.rough.deviation * mean, table.rough.deviation * deviation
