"""A data set: shapes, which points of them correspond, and whose shapes they are."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from esd.common import IntArray
from esd.mesh.mesh import Mesh


@dataclass(frozen=True, slots=True)
class Shape:
    """One shape of a collection; its data are read when they are asked for.

    Parameters
    ----------
    name : str
        Unique in its collection.
    subject : str
        Whose shape it is. Shapes of one subject never stand on both sides of a split.
    template : str
        Shapes of one template correspond with each other; those of different ones do not.
    mesh
        Reads the mesh.
    correspondence
        Reads the vertex of this shape at each point of the template, (p,); -1 where it has none.
    symmetric
        The same under the left-right symmetry of the body, or None where it is not known.
    """

    name: str
    subject: str
    template: str
    mesh: Callable[[], Mesh]
    correspondence: Callable[[], IntArray]
    symmetric: Callable[[], IntArray] | None = None


@dataclass(frozen=True, slots=True)
class Collection:
    """Shapes with correspondences, in a fixed order."""

    name: str
    shapes: tuple[Shape, ...]
