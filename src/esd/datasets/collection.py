"""A data set: shapes, which points of them correspond, and whose shapes they are."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from pathlib import Path

import numpy as np
import numpy.typing as npt

from esd.common import InputError, IntArray, existing_file, reason
from esd.mesh.io.landmarks import Landmarks
from esd.mesh.mesh import Mesh
from esd.mesh.repair.repair import Repaired, repair


@dataclass(frozen=True, slots=True)
class Shape:
    """One shape of a collection; its data are read when they are asked for.

    Parameters
    ----------
    name : str
        Unique in its collection.
    subject : str
        Whose shape it is. Shapes of one subject are never on both sides of a split.
    template : str
        Shapes of one template correspond with each other; those of different ones do not.
    mesh
        Reads the mesh.
    correspondence
        Reads the vertex of this shape at each point of the template, (p,); -1 where it has none.
    symmetric
        The same under the left-right symmetry of the body, or None where it is not known.
    parts
        Reads the name of the part of the body that each point of the template belongs to, (p,), or
        None where none are known.
    landmarks
        Reads its landmarks, those of one name corresponding on all shapes of a class, or None where
        none are known.
    """

    name: str
    subject: str
    template: str
    mesh: Callable[[], Mesh]
    correspondence: Callable[[], IntArray]
    symmetric: Callable[[], IntArray] | None = None
    parts: Callable[[], npt.NDArray[np.str_]] | None = None
    landmarks: Callable[[], Landmarks] | None = None


@dataclass(frozen=True, slots=True)
class Collection:
    """Shapes with correspondences, in a fixed order.

    Parameters
    ----------
    name : str
        Of the data set.
    shapes
        In the order in which figures name them.
    testing_subjects
        Subjects that the makers of the data set keep for testing.
    store
        File that holds the descriptors of its shapes, see `esd.datasets.store`, if one does.
    """

    name: str
    shapes: tuple[Shape, ...]
    testing_subjects: tuple[str, ...] = ()
    store: Path | None = None

    def __repr__(self) -> str:
        count = f"{len(self.shapes)} shapes of {len(self.subjects)} subjects"
        return f"<Collection '{self.name}': {count}>"

    def __getitem__(self, name: str) -> Shape:
        """The shape of a name.

        Raises
        ------
        InputError
            If there is none.
        """
        (shape,) = self.named([name])
        return shape

    def named(self, names: Sequence[str]) -> tuple[Shape, ...]:
        """The shapes of some names, in their order.

        Raises
        ------
        InputError
            If there is none of one of them.
        """
        known = {shape.name: shape for shape in self.shapes}
        for name in names:
            if name not in known:
                some = ", ".join(shape.name for shape in self.shapes[:3])
                raise InputError(f"'{self.name}' has no shape '{name}'; it has {some}, …")
        return tuple(known[name] for name in names)

    @property
    def subjects(self) -> tuple[str, ...]:
        """Subjects, each once, in order of first appearance."""
        return tuple(dict.fromkeys(shape.subject for shape in self.shapes))

    def unregistered(self) -> tuple[str, ...]:
        """Names of the shapes that correspond with no other."""
        count = Counter(shape.template for shape in self.shapes)
        return tuple(shape.name for shape in self.shapes if count[shape.template] == 1)

    def including(self, patterns: str) -> Collection:
        """Shapes whose name matches one of some patterns.

        Parameters
        ----------
        patterns
            Shell patterns (`*`, `?`, `[0-5]`), with commas between them.

        Raises
        ------
        InputError
            If no shape matches.
        """
        wanted = [pattern.strip() for pattern in patterns.split(",")]
        chosen = tuple(
            shape for shape in self.shapes if any(fnmatchcase(shape.name, p) for p in wanted)
        )
        if not chosen:
            some = ", ".join(shape.name for shape in self.shapes[:3])
            raise InputError(f"No shape of '{self.name}' matches '{patterns}'; it has {some}, …")
        return replace(self, shapes=chosen)

    def of_subjects(self, subjects: Sequence[str]) -> Collection:
        """Shapes of some subjects."""
        wanted = set(subjects)
        return replace(self, shapes=tuple(s for s in self.shapes if s.subject in wanted))

    def excluding_subjects(self, subjects: Sequence[str]) -> Collection:
        """Shapes of all but some subjects.

        Raises
        ------
        InputError
            If none is left.
        """
        left = self.of_subjects([name for name in self.subjects if name not in set(subjects)])
        if not left.shapes:
            raise InputError(f"No shape of '{self.name}' is left without {', '.join(subjects)}.")
        return left

    def pairs(self) -> tuple[tuple[Shape, Shape], ...]:
        """Ordered pairs (source, target) of different subjects of one template.

        Where no two shapes are so, all ordered pairs of one template.

        Raises
        ------
        InputError
            If there is no such pair either.
        """
        alike: dict[str, list[Shape]] = {}
        for shape in self.shapes:
            alike.setdefault(shape.template, []).append(shape)
        every = [(s, t) for s in self.shapes for t in alike[s.template] if t is not s]
        if not every:
            raise InputError(f"'{self.name}' has no two shapes that correspond with each other.")
        different = [(s, t) for s, t in every if s.subject != t.subject]
        return tuple(different or every)


def correspondences(shape: Shape, vertex_count: int) -> list[IntArray]:
    """The correspondence of a shape, and that of its mirror image where it is known.

    Parameters
    ----------
    vertex_count
        Of its mesh.

    Raises
    ------
    InputError
        If a correspondence names a vertex that the mesh lacks.
    """
    truths = [shape.correspondence()]
    if shape.symmetric is not None:
        truths.append(shape.symmetric())
    for truth in truths:
        if truth.max() >= vertex_count:
            raise InputError(
                f"The correspondence of '{shape.name}' names vertex {truth.max()} (from 0); "
                f"its mesh has {vertex_count} vertices."
            )
    return truths


def repaired_shape(shape: Shape) -> tuple[Repaired, IntArray, IntArray | None]:
    """A shape as it is matched, with all its pieces, and the vertices of the repaired mesh.

    The vertices are those of `Shape.correspondence` and `Shape.symmetric`, -1 where they could not
    be carried over.

    Raises
    ------
    InputError
        If a correspondence names a vertex that the mesh lacks, or nothing of it can be used.
    """
    mesh = shape.mesh()
    truths = correspondences(shape, len(mesh.vertices))
    try:
        repaired = repair(mesh, all_pieces=True, restore=True)
    except InputError as error:
        raise InputError(f"'{shape.name}': {error}") from error
    index, *symmetric = (np.where(truth >= 0, repaired.vertex_index[truth], -1) for truth in truths)
    return repaired, index, symmetric[0] if symmetric else None


def read_pairs(
    path: str | os.PathLike[str], collection: Collection
) -> tuple[tuple[Shape, Shape], ...]:
    """Pairs (source, target) listed in a file: two shape names with a tab between, one pair a line.

    Raises
    ------
    InputError
        If the file is not so, or names an unknown shape or two that do not correspond.
    """
    path = existing_file(path)
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except UnicodeDecodeError as error:
        raise InputError(f"'{path}' cannot be read: {reason(error)}.") from error
    listed: list[tuple[int, str, list[str]]] = []
    for number, line in enumerate(lines, start=1):
        if not line.strip():
            continue
        names = [name.strip() for name in line.split("\t")]
        if len(names) != 2:
            raise InputError(
                f"'{path}', line {number}: expected two shape names with a tab between; "
                f"got '{line}'."
            )
        listed.append((number, line, names))
    if not listed:
        raise InputError(f"'{path}' lists no pair.")
    shapes = collection.named([name for _, _, names in listed for name in names])
    pairs = tuple(zip(shapes[::2], shapes[1::2], strict=True))
    for (number, line, _), (source, target) in zip(listed, pairs, strict=True):
        if source.template != target.template:
            raise InputError(f"'{path}', line {number}: '{line}' do not correspond.")
    return pairs
