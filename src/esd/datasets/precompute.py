"""Descriptors of a whole collection, computed in many processes and kept in a store."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import numpy.typing as npt

from esd.common import UNFINISHED, InputError, IntArray, whole_file
from esd.datasets.collection import Collection, Shape, repaired_shape
from esd.datasets.remeshing import with_remeshings
from esd.datasets.store import Store, StoredShape, is_store, open_store, save_store
from esd.descriptors.recipe import Recipe, descriptors
from esd.mesh.mesh import Mesh
from esd.parallel import EVERY_CORE, Workers, outcomes
from esd.spectral.cache import content_key, default_cache

_VERSION = 2  # part of the keys; raised when the descriptors of a shape may change


@dataclass(frozen=True, slots=True)
class Precomputed:
    """What became of the shapes of a collection.

    Parameters
    ----------
    computed, unchanged
        Number of shapes whose descriptors were computed, and that were there before.
    failures
        Name of each shape that failed, and the reason.
    """

    computed: int
    unchanged: int
    failures: tuple[tuple[str, str], ...]


@dataclass(frozen=True, slots=True)
class _Job:
    """A shape, and the key under which the store has it, if it has."""

    shape: Shape
    stored: str | None


@dataclass(frozen=True, slots=True)
class _Described:
    """A shape whose descriptors are in the store, or in a part of it that is named by the key."""

    key: str
    vertices: int
    points: int
    is_new: bool


def precompute(
    collection: Collection,
    recipe: Recipe,
    path: str | os.PathLike[str],
    *,
    remeshings: int = 0,
    workers: Workers = EVERY_CORE,
    renew: bool = False,
    on_shape: Callable[[], None] = lambda: None,
) -> Precomputed:
    """Write the descriptors of a collection's shapes to a store, or bring the store up to date.

    Shapes that the store has, with equal content, are not computed again; those it has of the
    same collection beyond these remain. Each shape is first written to a part of its own, in the
    folder `PATH.parts`, from which an interrupted run resumes. Spectra go to the user's cache of
    the process that computes.

    Parameters
    ----------
    path
        Of the store.
    remeshings
        Copies of each shape with other triangles that are described as well, see
        `esd.datasets.remeshing.with_remeshings`.
    workers
        What computes. Workers of a scheduler must see the files of the collection
        and the folder of the store under the same names.
    renew
        Whether a store that exists is computed anew; it is replaced when the new one is whole.
    on_shape
        Called after each shape, to show progress.

    Raises
    ------
    InputError
        If the store is of another recipe or collection, or cannot be written.
    """
    path = Path(path).resolve()
    if path.exists() and not is_store(path):
        raise InputError(f"'{path}' is no store of descriptors and is not replaced; remove it.")
    old = open_store(path) if path.exists() and not renew else None
    if old is not None:
        _check_same(old, collection, recipe, remeshings)
    keys = {} if old is None else dict(zip(old.names, old.keys, strict=True))
    shapes = with_remeshings(collection, remeshings, seed=0).shapes
    parts = path.with_name(path.name + ".parts")
    try:
        parts.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"'{parts}' cannot be written to: {error.strerror}.") from error

    jobs = (_Job(shape, keys.get(shape.name)) for shape in shapes)
    entries = {} if old is None else {shape.name: shape for shape in old.shapes()}
    before = list(entries.values())
    failures, computed, unchanged = [], 0, 0
    work = partial(_described, recipe=recipe, parts=parts)
    for outcome in outcomes(work, jobs, workers=workers):
        shape, done = outcome.job.shape, outcome.result
        if done is None:
            failures.append((shape.name, outcome.failure or ""))
            entries.pop(shape.name, None)  # the store has it with another content, if at all
        else:
            read = (
                entries[shape.name].read
                if done.key == outcome.job.stored
                else partial(_read_part, parts / f"{done.key}.npz")
            )
            entries[shape.name] = StoredShape(
                shape.name,
                shape.subject,
                shape.template,
                done.key,
                done.vertices,
                done.points,
                read,
            )
            computed += done.is_new
            unchanged += not done.is_new
        on_shape()
    written = [entries[name] for name in sorted(entries)]
    if written and [shape.identity for shape in written] != [shape.identity for shape in before]:
        save_store(path, written, collection=collection, recipe=recipe, remeshings=remeshings)
    _remove_parts(parts)
    return Precomputed(computed, unchanged, tuple(sorted(failures)))


def _remove_parts(parts: Path) -> None:
    """Remove what `_described` wrote to a folder, and the folder if it held nothing else."""
    for part in (*parts.glob("described-*.npz"), *parts.glob(f"{UNFINISHED}*.npz")):
        part.unlink(missing_ok=True)
    with contextlib.suppress(OSError):
        parts.rmdir()


def _check_same(store: Store, collection: Collection, recipe: Recipe, remeshings: int) -> None:
    if store.collection != collection.name:
        raise InputError(
            f"'{store.path}' holds shapes of '{store.collection}', not of '{collection.name}'; "
            "choose another name."
        )
    if (store.recipe.to_json(), store.remeshings) != (recipe.to_json(), remeshings):
        raise InputError(
            f"'{store.path}' holds the descriptors of another recipe; choose another name."
        )


def _described(job: _Job, *, recipe: Recipe, parts: Path) -> _Described:
    """Compute the part of a shape, unless it is there."""
    shape = job.shape
    repaired, index, _ = repaired_shape(shape)
    mesh = repaired.shape
    assert isinstance(mesh, Mesh)
    key = content_key(
        "described", mesh.vertices, mesh.faces, index, recipe=recipe.to_json(), version=_VERSION
    )
    part = parts / f"{key}.npz"
    is_new = key != job.stored and not part.exists()
    if is_new:
        values = descriptors(recipe, mesh, cache=default_cache())
        defined = np.asarray(np.isfinite(values).all(axis=1))
        with whole_file(part) as temporary:
            np.savez(
                temporary,
                descriptors=values.astype(np.float32),
                correspondence=np.where((index >= 0) & defined[index], index, -1),
            )
    return _Described(key, len(mesh.vertices), len(index), is_new)


def _read_part(part: Path) -> tuple[npt.NDArray[np.float32], IntArray]:
    with np.load(part, allow_pickle=False) as arrays:
        return arrays["descriptors"], arrays["correspondence"]
