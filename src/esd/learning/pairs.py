"""Pairs of corresponding and other points, drawn from training data."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from esd.common import InputError, IntArray
from esd.learning.table import PointTable


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
    first_rows, second_rows = _draw_shapes(table, generator)
    half = count // 2
    size = len(first_rows)
    first = generator.integers(size, size=count)
    # another point: any step but a full round leads away from the first
    step = generator.integers(1, size, size=count - half)
    second = np.concatenate([first[:half], (first[half:] + step) % size])
    label = np.concatenate([np.ones(half), generator.uniform(0, soft_label, size=count - half)])
    return PairBatch(first_rows[first], second_rows[second], label.astype(np.float32))


def draw_matches(table: PointTable, generator: np.random.Generator, *, count: int) -> PairBatch:
    """A batch of corresponding pairs from two different shapes of one template, at random.

    No point of the template occurs twice, so that each point of one shape has one match among
    those of the other. There are fewer than `count` if the shapes share fewer points.

    Raises
    ------
    InputError
        If no two shapes correspond.
    """
    source, target = _draw_shapes(table, generator)
    chosen = generator.choice(len(source), size=min(count, len(source)), replace=False)
    label = np.ones(len(chosen), dtype=np.float32)
    return PairBatch(source[chosen], target[chosen], label)


def _draw_shapes(table: PointTable, generator: np.random.Generator) -> tuple[IntArray, IntArray]:
    """Rows of two different shapes of one template at the points that both have."""
    a = int(generator.integers(len(table.rows)))
    partners = np.flatnonzero(table.templates == table.templates[a])
    if len(partners) < 2:
        raise InputError("Training needs at least two shapes of each template.")
    drawn = int(generator.integers(len(partners) - 1))
    b = int(partners[drawn + (drawn >= np.searchsorted(partners, a))])  # any of them but a
    both = np.flatnonzero((table.rows[a] >= 0) & (table.rows[b] >= 0))
    if len(both) < 2:
        raise InputError("Two training shapes have fewer than two points in common.")
    return table.rows[a][both], table.rows[b][both]
