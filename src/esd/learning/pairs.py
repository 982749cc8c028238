"""Training data in memory, and the drawing of pairs of corresponding and other points."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from esd.common import FloatArray, InputError, IntArray
from esd.datasets.collection import Collection, check_correspondence
from esd.descriptors.recipe import Recipe, descriptors
from esd.spectral.cache import Cache


@dataclass(frozen=True, slots=True, eq=False)
class PointTable:
    """Descriptors of all shapes of a collection at the points of their templates.

    Parameters
    ----------
    values : (vertices of all shapes, width) float32
        Descriptors, the shapes one after another.
    rows : for each shape (points,) int64
        Row of `values` at each point of the shape's template; -1 where it has none.
    templates
        Template of each shape.
    """

    values: npt.NDArray[np.float32]
    rows: tuple[IntArray, ...]
    templates: tuple[str, ...]

    def standardised(self, mean: FloatArray, deviation: FloatArray) -> PointTable:
        """The table with its values less a mean and divided by a deviation, (width,) each."""
        return replace(self, values=((self.values - mean) / deviation).astype(np.float32))


@dataclass(frozen=True, slots=True, eq=False)
class PairBatch:
    """Pairs of points as rows of a `PointTable`.

    Parameters
    ----------
    source, target : (b,)
        Rows. The first half of the pairs correspond, the second half do not.
    label : (b,) float32
        y of the contrastive loss.
    """

    source: IntArray
    target: IntArray
    label: npt.NDArray[np.float32]


def point_table(
    collection: Collection,
    recipe: Recipe,
    *,
    cache: Cache | None = None,
    on_shape: Callable[[], None] = lambda: None,
) -> PointTable:
    """Descriptors and correspondences of a collection.

    Parameters
    ----------
    on_shape
        Called after each shape, to show progress.

    Raises
    ------
    InputError
        If a shape cannot be read or described, or points outside its mesh.
    """
    values, rows, start = [], [], 0
    for shape in collection.shapes:
        mesh = shape.mesh()
        index = shape.correspondence()
        check_correspondence(shape, index, mesh)
        try:
            columns = descriptors(recipe, mesh, cache=cache)
        except InputError as error:
            raise InputError(f"'{shape.name}': {error}") from error
        defined = np.isfinite(columns[index]).all(axis=1)
        rows.append(np.where((index >= 0) & defined, index + start, -1))
        values.append(columns.astype(np.float32))
        start += len(columns)
        on_shape()
    templates = tuple(shape.template for shape in collection.shapes)
    return PointTable(np.concatenate(values), tuple(rows), templates)


def standardisation(table: PointTable) -> tuple[FloatArray, FloatArray]:
    """Mean and standard deviation of each column, (width,) each, over all vertices of all shapes.

    Columns that never vary have deviation one.
    """
    values = table.values[np.isfinite(table.values).all(axis=1)]
    mean = values.mean(axis=0, dtype=np.float64)
    deviation = values.std(axis=0, dtype=np.float64)
    return mean, np.where(deviation > 0, deviation, 1.0)


def draw_pairs(
    table: PointTable, generator: np.random.Generator, *, count: int, soft_label: float
) -> PairBatch:
    """A batch of pairs from two different shapes of one template, drawn at random.

    Half of the pairs correspond, with label 1; the other half do not, with labels uniform between
    0 and `soft_label`, because points such as two thumbs look alike and do not correspond
    (section 3.5 of the paper).

    Raises
    ------
    InputError
        If no two shapes correspond.
    """
    a = int(generator.integers(len(table.rows)))
    partners = [
        i for i, template in enumerate(table.templates) if template == table.templates[a] and i != a
    ]
    if not partners:
        raise InputError("Training needs at least two shapes of each template.")
    b = partners[int(generator.integers(len(partners)))]
    both = np.flatnonzero((table.rows[a] >= 0) & (table.rows[b] >= 0))
    if len(both) < 2:
        raise InputError("Two training shapes have fewer than two points in common.")
    half = count // 2
    first = generator.integers(len(both), size=count)
    # another point: any step but a full round leads away from the first
    step = generator.integers(1, len(both), size=count - half)
    second = np.concatenate([first[:half], (first[half:] + step) % len(both)])
    label = np.concatenate([np.ones(half), generator.uniform(0, soft_label, size=count - half)])
    return PairBatch(
        table.rows[a][both[first]], table.rows[b][both[second]], label.astype(np.float32)
    )
