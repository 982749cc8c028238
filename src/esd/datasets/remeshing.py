"""Shapes with other triangles, made when they are asked for and kept in the user's cache."""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from esd.common import InputError, IntArray
from esd.datasets.collection import Collection, Shape
from esd.mesh.mesh import Mesh
from esd.mesh.remesh.remesh import remesh
from esd.mesh.remesh.styles import STYLES, Style
from esd.mesh.repair.repair import repair
from esd.spectral.cache import Arrays, content_key, default_cache

_log = logging.getLogger(__name__)

COARSEST, DENSEST = 2500, 9000
"""Numbers of vertices between which those of `with_remeshings` are drawn, evenly in logarithm."""

_TRAINING_STYLES = tuple(name for name in STYLES if name != "graded")


@dataclass(frozen=True, slots=True)
class _Remeshing:
    """A shape of a collection with triangles of its own.

    Parameters
    ----------
    shape
        The shape as it was.
    vertex_count, style, seed
        See `esd.mesh.remesh.remesh`.
    """

    shape: Shape
    vertex_count: int
    style: str | Style
    seed: int

    def mesh(self) -> Mesh:
        """The new mesh."""
        return _remeshed(self)[0]

    def correspondence(self) -> IntArray:
        """The new vertex at each point of the template; -1 where it has none."""
        return self._moved(self.shape.correspondence())

    def symmetric(self) -> IntArray:
        """The same under the symmetry of the body; for shapes of which that is known."""
        return self._moved(self.shape.symmetric()) if self.shape.symmetric else np.empty(0, int)

    def _moved(self, index: IntArray) -> IntArray:
        return np.where(index >= 0, _remeshed(self)[1][index], -1)


def remeshed_shape(
    shape: Shape, *, vertex_count: int, style: str | Style, seed: int, name: str | None = None
) -> Shape:
    """A shape with other triangles; nothing is computed until it is asked for."""
    made = _Remeshing(shape, vertex_count, style, seed)
    return replace(
        shape,
        name=name or shape.name,
        mesh=made.mesh,
        correspondence=made.correspondence,
        symmetric=made.symmetric if shape.symmetric else None,
    )


def with_remeshings(collection: Collection, copies: int, *, seed: int) -> Collection:
    """A collection with some copies of each shape, of random style and number of vertices.

    A shape that cannot be remeshed, because it is no oriented manifold, is copied as it is.
    """
    generator = np.random.default_rng(seed)
    shapes = list(collection.shapes)
    for shape in collection.shapes:
        for copy in range(copies):
            count = COARSEST * (DENSEST / COARSEST) ** generator.uniform()
            shapes.append(
                remeshed_shape(
                    shape,
                    vertex_count=round(count),
                    style=_TRAINING_STYLES[generator.integers(len(_TRAINING_STYLES))],
                    seed=int(generator.integers(2**32)),
                    name=copy_name(shape.name, copy),
                )
            )
    return replace(collection, shapes=tuple(shapes))


def copy_name(name: str, copy: int) -> str:
    """Name of a copy, from 0, that `with_remeshings` makes of a shape."""
    return f"{name}~{copy}"


@lru_cache(maxsize=4)  # mesh and correspondences are asked for one after the other
def _remeshed(made: _Remeshing) -> tuple[Mesh, IntArray]:
    """The new mesh, and its vertex nearest to each old one or -1, from the user's cache."""
    old = made.shape.mesh()

    def compute() -> Arrays:
        repaired = repair(old, all_pieces=True, restore=True)
        sound, place = repaired.shape, repaired.vertex_index
        assert isinstance(sound, Mesh)
        new, nearest = sound, np.arange(len(sound.vertices))
        try:
            found = remesh(sound, made.vertex_count, style=made.style, seed=made.seed)
            new, nearest = found.mesh, found.nearest
        except InputError as error:
            _log.warning("'%s' keeps its triangles: %s", made.shape.name, error)
        nearest = np.where(place >= 0, nearest[place], -1)
        return {"vertices": new.vertices, "faces": new.faces, "nearest": nearest}

    store = default_cache()
    parameters = {"count": made.vertex_count, "style": str(made.style), "seed": made.seed}
    # of the mesh as it came: what is found in the cache need not be repaired before
    key = content_key("remeshed", old.vertices, old.faces, repaired=True, **parameters)
    arrays = compute() if store is None else store.computed(key, compute)
    return Mesh(arrays["vertices"], arrays["faces"]), arrays["nearest"]
