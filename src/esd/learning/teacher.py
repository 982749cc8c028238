"""The teacher of learning without correspondences: maps between samples that can be relied on.

A network that knows little finds a rough map; refined with more and more eigenfunctions it becomes
a good one, of which only matches are kept that return and that keep the orientation of the surface.
These are what the network learns next.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree

from esd.common import FloatArray, IntArray
from esd.learning.model import Model
from esd.learning.samples import MARKS, Samples

Rows = npt.NDArray[np.float32]

FIRST_SIZES = (8, 14, 20)
"""Numbers of eigenfunctions with which a refinement begins; more of them lose poses and limbs."""

_WEIGHT = 0.6  # of embeddings beside eigenfunctions
_LED_WEIGHT = 10.0  # of the closeness to known points beside embeddings
_FEWEST_MARKS = 3  # known points that lead a map
_RETURNING = 0.06  # over √area: farthest miss of a match that returns
_ORIENTED = 0.3  # least correlation of neighbourhoods
_LEAST_ORIENTED = 0.6  # share of a map that is learned from
_FEWEST_MATCHES = 20
_NEIGHBOURS = 8
_RIDGE = 1e-3  # of the least squares, times the mean of the diagonal
_LEAST_GAP = 0.03  # of matched embeddings, below which they count no more


@dataclass(frozen=True, slots=True, eq=False)
class Lesson:
    """Matches between two shapes that can be relied on.

    Parameters
    ----------
    source, target : (q,)
        Rows of the samples of either shape.
    returning
        Share of the points tried that come back to where they were, by way of the other shape.
    oriented
        Share of them whose neighbourhood keeps its orientation.
    kept
        Share of them that do both, clearly.
    """

    source: IntArray
    target: IntArray
    returning: float
    oriented: float
    kept: float


@dataclass(frozen=True, slots=True, eq=False)
class FirstMaps:
    """Maps between samples that are known before anything is learned.

    Parameters
    ----------
    maps
        By the numbers of source and target: the row of the target for each row of the source, (p,).
    chains
        By the same: numbers of the shapes from the source to the target, both included, through
        which the map goes; none where no map can be trusted.
    near
        Numbers of two shapes, the lesser first, whose direct maps are expected to be good: so
        alike that a refinement, which takes them for isometric, does no harm.
    start
        The model that most of the maps are by, to start from; None if they are by descriptors.
    """

    maps: Mapping[tuple[int, int], IntArray]
    chains: Mapping[tuple[int, int], tuple[int, ...]]
    near: Sequence[tuple[int, int]] = ()
    start: Model | None = None

    def pairs(self) -> list[tuple[int, int]]:
        """Numbers of the shapes that chains connect there and back, the lesser first."""
        return [(i, j) for i, j in self.chains if i < j and (j, i) in self.chains]

    def lesson(self, samples: Sequence[Samples], source: int, target: int) -> Lesson | None:
        """The matches along the chains there and back; None where there is none."""
        if not {(source, target), (target, source)} <= self.chains.keys():
            return None
        forth, back = self._along(source, target), self._along(target, source)
        rows = np.arange(len(forth)), np.arange(len(back))
        return sifted(samples[source], samples[target], rows, forth, back)

    def _along(self, source: int, target: int) -> IntArray:
        chain = self.chains[source, target]
        index = self.maps[chain[0], chain[1]]
        for step in pairwise(chain[1:]):
            index = self.maps[step][index]  # row of the source -> row of the next shape
        return index


def lesson(
    source: Samples,
    target: Samples,
    embed: Callable[[Rows], Rows],
    *,
    sizes: Sequence[int],
    count: int,
    generator: np.random.Generator,
) -> Lesson:
    """Matches found from the nearest embeddings, refined, and sifted.

    Where both shapes have known points in common, three or more, the closeness to these is
    used beside the embeddings.

    Parameters
    ----------
    embed
        Gives the embeddings (p, d), rows of unit length, of standardised descriptors (p, width).
    sizes
        Ascending numbers of eigenfunctions.
    count
        Points of either shape that are drawn and tried.
    """
    # rows of the points that are tried, p of the source and q of the target
    p, q = (generator.permutation(len(each.positions))[:count] for each in (source, target))
    embedded = embed(source.values[0][p]), embed(target.values[0][q])
    closeness = shared_closeness(source, target)
    if closeness is not None:
        embedded = (
            np.hstack([embedded[0], _LED_WEIGHT * closeness[0][p]]),
            np.hstack([embedded[1], _LED_WEIGHT * closeness[1][q]]),
        )
    functions = source.eigenvectors[p], target.eigenvectors[q]
    forth, back = refined(functions, embedded, sizes=sizes)
    return sifted(source, target, (p, q), forth, back)


def sifted(
    source: Samples,
    target: Samples,
    rows: tuple[IntArray, IntArray],
    forth: IntArray,
    back: IntArray,
) -> Lesson:
    """Those matches of a map that return and that keep the orientation of their neighbourhood.

    Parameters
    ----------
    rows : (n,) and (m,)
        Rows of the samples of either shape that are matched.
    forth, back : (n,) and (m,)
        Indices into the rows of the other shape.
    """
    p, q = rows
    here = source.positions[p]
    returns = np.linalg.norm(here[back[forth]] - here, axis=1) < _RETURNING
    image = q[forth]
    turn = orientation(here, source.normals[p], target.positions[image], target.normals[image])
    kept = returns & (turn > _ORIENTED)
    return Lesson(
        p[kept],
        image[kept],
        float(returns.mean()),
        float((turn > 0).mean()),
        float(kept.mean()),
    )


def shared_closeness(source: Samples, target: Samples) -> tuple[Rows, Rows] | None:
    """Closeness to the points known on both shapes, (p, q) each, in rows of unit length.

    None where there are too few for a map to be led by.
    """
    names = [name for name in source.closeness if name in target.closeness][:MARKS]
    if len(names) < _FEWEST_MARKS:
        return None
    rows = (np.stack([each.closeness[name] for name in names], 1) for each in (source, target))
    a, b = (each / np.linalg.norm(each, axis=1, keepdims=True) for each in rows)
    return a, b


def refined(
    functions: tuple[Rows, Rows], embedded: tuple[Rows, Rows], *, sizes: Sequence[int]
) -> tuple[IntArray, IntArray]:
    """The maps forth (n,) and back (m,) between samples, of more and more eigenfunctions.

    As `esd.matching.refine.zoomout`, bijective, with embeddings beside; but functional maps are
    solved by least squares, since eigenfunctions at some of the vertices are not orthogonal.

    Parameters
    ----------
    functions : (n, k) and (m, k)
        Eigenfunctions at the samples of both shapes; sizes beyond k are k.
    embedded : (n, d) and (m, d)
    """
    forth, back = mutually_nearest(*embedded)
    for size in sizes:
        a, b = (each[:, :size] for each in functions)
        # C takes functions of the target to the source, a C ≈ b∘forth, and D those of the source
        c, d = _functional_map(a, b[forth]), _functional_map(b, a[back])
        first, second = np.hstack([a, a @ d.T]), np.hstack([b @ c.T, b])
        gap = max(_gap(*embedded, forth, back), _LEAST_GAP)
        scale = np.float32(_WEIGHT * _gap(first, second, forth, back) / gap)
        forth, back = mutually_nearest(
            np.hstack([first, scale * embedded[0]]), np.hstack([second, scale * embedded[1]])
        )
    return forth, back


def mutually_nearest(source: Rows, target: Rows) -> tuple[IntArray, IntArray]:
    """The nearest row of the target to each of the source, (n,), and back, (m,), by one product."""
    product = source @ target.T
    forth = (product - (target**2).sum(axis=1) / 2).argmax(axis=1)
    back = (product - (source**2).sum(axis=1)[:, None] / 2).argmax(axis=0)
    return forth, back


def orientation(
    positions: FloatArray, normals: FloatArray, images: FloatArray, image_normals: FloatArray
) -> FloatArray:
    """How a map turns the neighbourhood of each point, (n,): 1 for keeping it, −1 for mirroring.

    For tangent vectors x to the nearest of the other points and y to their images it is
    det Σ x yᵀ / √(det Σ x xᵀ det Σ y yᵀ): by Cauchy and Binet the correlation of the signed areas
    of the triangles of two neighbours, before and after; averaged over the neighbours.

    Parameters
    ----------
    positions, normals, images, image_normals : (n, 3)
    """
    # the first neighbour of a point is itself
    near = KDTree(positions).query(positions, k=min(_NEIGHBOURS + 1, len(positions)))[1][:, 1:]
    x, y = positions[near] - positions[:, None], images[near] - images[:, None]
    numerator = _tangent_determinant(x, y, normals, image_normals)
    squares = _tangent_determinant(x, x, normals, normals) * _tangent_determinant(
        y, y, image_normals, image_normals
    )
    tiny = np.finfo(np.float32).tiny
    turn = np.clip(numerator / np.sqrt(np.maximum(squares, tiny)), -1.0, 1.0)
    return np.asarray(turn[near].mean(axis=1))


def _tangent_determinant(
    x: FloatArray, y: FloatArray, normals: FloatArray, other: FloatArray
) -> FloatArray:
    """Determinant of Σ x yᵀ in the tangent planes, (n,): nᵀ cof(Σ x yᵀ) n'.

    For vectors x and y (n, k, 3) in space.
    """
    a, b, c = np.einsum("kpi,kpj->ikj", x, y)  # the rows of the matrices
    cofactors = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=1)
    return np.einsum("ki,kij,kj->k", normals, cofactors, other)


def _functional_map(functions: Rows, wanted: Rows) -> Rows:
    """C of the least squares functions · C ≈ wanted, (k, k)."""
    gram = functions.T @ functions
    ridge = _RIDGE * np.trace(gram) / len(gram) * np.eye(len(gram), dtype=gram.dtype)
    return np.asarray(np.linalg.solve(gram + ridge, functions.T @ wanted))


def _gap(source: Rows, target: Rows, forth: IntArray, back: IntArray) -> float:
    """Root mean squared distance of matched rows, both ways."""
    there = ((source - target[forth]) ** 2).sum(axis=1).mean()
    here = ((target - source[back]) ** 2).sum(axis=1).mean()
    return float(np.sqrt((there + here) / 2))


def is_reliable(found: Lesson) -> bool:
    """Whether anything can be learned from it: most of the map must keep its orientation."""
    return found.oriented >= _LEAST_ORIENTED and len(found.source) >= _FEWEST_MATCHES
