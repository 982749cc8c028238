"""What learning without correspondences keeps of each shape: descriptors at some of its points."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial

import numpy as np
import numpy.typing as npt

from esd.common import FloatArray, InputError, IntArray
from esd.datasets.collection import Collection, Shape, repaired_shape
from esd.datasets.deformation import deformed
from esd.descriptors.recipe import Recipe, recipe_spectrum, spectrum_descriptors
from esd.mesh.geodesics import geodesic_graph
from esd.mesh.geometry import surface_area, vertex_areas, vertex_normals
from esd.mesh.mesh import Mesh
from esd.mesh.topology import oriented_outward
from esd.parallel import THIS_PROCESS, Workers, outcomes
from esd.spectral.cache import Cache, content_key

MARKS = 32
"""Largest number of known points whose distances lead a map."""

_TEMPLATE_POINTS = 400  # points of a template that are kept, of each of its shapes the same
_NEAR = 0.05  # over √area: added to distances from known points before they are inverted


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """Some points of a shape, spread by area, with all that the training takes of them.

    Parameters
    ----------
    name
        Of the shape.
    values : (p, width) float32 each
        Descriptors of the shape, then of deformed copies of it, at the same points.
    eigenvectors : (p, k) float32
        Of the shape scaled to unit area.
    positions, normals : (p, 3) float32
        Positions over √area, and outward unit normals.
    vertices : (p,)
        The vertices of the repaired mesh that the points are.
    content
        Key of the repaired mesh, by which doubles are found.
    known
        Row of each point whose counterparts on other shapes are known, by the name that it has on
        all of them.
    closeness : by the same names, (p,) float32
        1 / (d + 0.05) for the geodesic distance d over √area from the point.
    """

    name: str
    values: tuple[npt.NDArray[np.float32], ...]
    eigenvectors: npt.NDArray[np.float32]
    positions: npt.NDArray[np.float32]
    normals: npt.NDArray[np.float32]
    vertices: IntArray
    content: str = ""
    known: Mapping[str, int] = field(default_factory=dict)
    closeness: Mapping[str, npt.NDArray[np.float32]] = field(default_factory=dict)

    def shared(self, other: Samples) -> tuple[IntArray, IntArray]:
        """Rows of the points that are known on both shapes, (q,) each."""
        names = [name for name in self.known if name in other.known]
        rows = [[each.known[name] for name in names] for each in (self, other)]
        source, target = np.array(rows, dtype=np.int64).reshape(2, -1)
        return source, target


@dataclass(frozen=True, slots=True, eq=False)
class SampledCollection:
    """The samples of a collection's shapes, in its order, and why some have none.

    Parameters
    ----------
    failures
        Why a shape was left out, by its name.
    """

    samples: tuple[Samples, ...]
    failures: Mapping[str, str]


def shape_samples(
    shape: Shape,
    *,
    recipe: Recipe,
    points: int,
    eigenfunctions: int,
    copies: int,
    seed: int,
    is_known: bool = False,
    cache: Cache | None = None,
) -> Samples:
    """Samples of a shape.

    Parameters
    ----------
    points
        Number of points, drawn by area, beside those that are known; fewer on small meshes.
    eigenfunctions
        Number of eigenfunctions that are kept.
    copies
        Number of copies, smoothly deformed, see `esd.datasets.deformation.deformed`.
    is_known
        Whether other shapes have its template, so that its correspondences say something.
    cache
        Where spectra are looked up and kept.

    Raises
    ------
    InputError
        If the shape cannot be read or described.
    """
    repaired, template_points, _ = repaired_shape(shape)
    if not isinstance(repaired.shape, Mesh):
        raise InputError("it has no faces, which the descriptors need")
    mesh = oriented_outward(repaired.shape)
    spectrum = recipe_spectrum(recipe, mesh, cache=cache).with_area(1.0)
    known = _landmarks(shape, repaired.vertex_index)
    if is_known:
        known |= _template_points(shape, template_points)
    area = vertex_areas(mesh)
    area[len(area) - repaired.filling :] = 0.0
    generator = np.random.default_rng(seed)
    count = min(points, int((area > 0).sum()))
    drawn = generator.choice(len(area), size=count, replace=False, p=area / area.sum())
    chosen, rows = np.unique(np.concatenate([[*known.values()], drawn]), return_inverse=True)
    chosen = chosen.astype(np.int64)
    values = [spectrum_descriptors(recipe, mesh, spectrum)[chosen].astype(np.float32)]
    for copy in range(copies):
        other = deformed(mesh, seed=seed + copy)
        described = spectrum_descriptors(recipe, other, recipe_spectrum(recipe, other, cache=cache))
        values.append(described[chosen].astype(np.float32))
    scale = np.sqrt(surface_area(mesh))
    near = {}
    if known:
        graph = geodesic_graph(mesh)
        for name in list(known)[:MARKS]:
            near[name] = closeness(graph.distances(np.array([known[name]]))[0, chosen] / scale)
    return Samples(
        name=shape.name,
        values=tuple(values),
        eigenvectors=spectrum.eigenvectors[chosen, :eigenfunctions].astype(np.float32),
        positions=(mesh.vertices[chosen] / scale).astype(np.float32),
        normals=vertex_normals(mesh)[chosen].astype(np.float32),
        vertices=chosen,
        content=content_key("samples", mesh.vertices, mesh.faces),
        known=dict(zip(known, rows[: len(known)].tolist(), strict=True)),
        closeness=near,
    )


def closeness(distance: FloatArray) -> npt.NDArray[np.float32]:
    """1 / (d + 0.05) for geodesic distances d over √area, of the same shape."""
    return (1 / (distance + _NEAR)).astype(np.float32)


def collection_samples(
    collection: Collection,
    *,
    recipe: Recipe,
    points: int,
    eigenfunctions: int,
    copies: int,
    seed: int = 0,
    workers: Workers = THIS_PROCESS,
    cache: Cache | None = None,
    on_shape: Callable[[], None] = lambda: None,
) -> SampledCollection:
    """Samples of all shapes of a collection that can be described.

    Parameters
    ----------
    workers
        What computes. See `shape_samples` for the others.
    on_shape
        Called after each shape.
    """
    describe = partial(
        _numbered_samples,
        recipe=recipe,
        points=points,
        eigenfunctions=eigenfunctions,
        copies=copies,
        cache=cache,
    )
    alone = set(collection.unregistered())
    jobs = [
        (shape, (seed + 1000 * i) % 2**32, shape.name not in alone)
        for i, shape in enumerate(collection.shapes)
    ]
    found: dict[str, Samples] = {}
    failures: dict[str, str] = {}
    for outcome in outcomes(describe, jobs, workers=workers):
        name = outcome.job[0].name
        if outcome.result is None:
            failures[name] = outcome.failure or ""
        else:
            found[name] = outcome.result
        on_shape()
    names = [shape.name for shape in collection.shapes if shape.name in found]
    return SampledCollection(tuple(found[name] for name in names), failures)


def _numbered_samples(
    job: tuple[Shape, int, bool],
    *,
    recipe: Recipe,
    points: int,
    eigenfunctions: int,
    copies: int,
    cache: Cache | None,
) -> Samples:
    """Samples of a shape, with a seed, whose template others share or not."""
    shape, seed, is_known = job
    return shape_samples(
        shape,
        recipe=recipe,
        points=points,
        eigenfunctions=eigenfunctions,
        copies=copies,
        seed=seed,
        is_known=is_known,
        cache=cache,
    )


def _landmarks(shape: Shape, vertex_index: IntArray) -> dict[str, int]:
    """Vertices of the repaired mesh that are landmarks of the shape, by name."""
    if shape.landmarks is None:
        return {}
    landmarks = shape.landmarks()
    place = vertex_index[landmarks.vertices].tolist()
    found = zip(landmarks.names, landmarks.vertices.tolist(), place, strict=True)
    return {f"landmark {name}": there for name, here, there in found if here >= 0 <= there}


def _template_points(shape: Shape, points: IntArray) -> dict[str, int]:
    """Vertices at some points of the shape's template, by name."""
    order = np.random.default_rng(0).permutation(len(points))[:_TEMPLATE_POINTS].tolist()
    return {f"{shape.template} {i}": int(points[i]) for i in order if points[i] >= 0}


def moments(samples: tuple[Samples, ...]) -> tuple[FloatArray, FloatArray]:
    """Mean and standard deviation of each descriptor over all points and copies, (width,) each.

    Those that never vary have deviation one.
    """
    parts = [values for each in samples for values in each.values]
    count = sum(len(part) for part in parts)
    mean = sum(part.sum(axis=0, dtype=np.float64) for part in parts) / count
    variance = sum(((part - mean) ** 2).sum(axis=0) for part in parts) / count
    deviation = np.sqrt(variance)
    return mean, np.where(deviation > 0, deviation, 1.0)
