"""People with the triangles and the defects that meshes from elsewhere have, and maps between them.

    python benchmarks/real_triangles.py MODEL FAUST_R 'tr_reg_0[67]*' --pairs 12

Every shape is rotated at random, and both of a pair are altered in the same way, see `KINDS`, each
with a seed of its own; maps are those of `esd match` without options. The error is measured on the
target as it was, so that welded limbs are no shortcut. Needs fast-simplification, which
`pip install '.[dev]'` brings.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import replace
from typing import TypeAlias

import fast_simplification
import numpy as np
from scipy.spatial import KDTree

from esd.common import FloatArray, IntArray
from esd.datasets.collection import Shape
from esd.datasets.open import open_collection
from esd.datasets.perturb import short_circuits
from esd.evaluation.errors import geodesic_errors
from esd.evaluation.protocol import randomly_rotated
from esd.learning.model import load_model
from esd.matching.features import Features
from esd.matching.match import match_features, prepared, working_features
from esd.mesh.geodesics import geodesic_graph
from esd.mesh.geometry import surface_area
from esd.mesh.mesh import Mesh
from esd.mesh.shapes import subdivide
from esd.spectral.cache import default_cache

Altered: TypeAlias = tuple[Mesh, IntArray]
"""A mesh, and its vertex at each vertex of the mesh that it was made of, -1 where that is gone."""

POINTS = 1000  # at which errors are measured
FAR = 20  # per cent of √area, beyond which a vertex is on another limb


def decimated(mesh: Mesh, count: int) -> Mesh:
    """By quadric error metrics: fewer triangles where the surface is flat."""
    scale = np.sqrt(surface_area(mesh))
    vertices, faces = fast_simplification.simplify(
        (mesh.vertices / scale).astype(np.float32),
        mesh.faces.astype(np.int32),
        target_count=min(2 * count, len(mesh.faces) - 1),
    )
    return Mesh(vertices.astype(float) * scale, faces)


def with_long_triangles(mesh: Mesh, count: int, *, stretch: float, axis: FloatArray) -> Mesh:
    """Decimated while the surface is so many times as long along a direction."""
    along = axis / np.linalg.norm(axis)
    taller = np.eye(3) + (stretch - 1) * np.outer(along, along)
    made = decimated(subdivide(replace(mesh, vertices=mesh.vertices @ taller)), count)
    return replace(made, vertices=made.vertices @ np.linalg.inv(taller))


def with_defects(mesh: Mesh, share: float, rng: np.random.Generator) -> Mesh:
    """With faces there twice, as they are or turned over, and faces that stand on an edge of two.

    Parameters
    ----------
    share
        Number of each of both kinds, as a share of the faces.
    """
    count = max(2, round(share * len(mesh.faces)))
    twice, under = (mesh.faces[rng.choice(len(mesh.faces), count, False)] for _ in range(2))
    twice[count // 2 :] = twice[count // 2 :, ::-1]
    middle = mesh.vertices[under].mean(axis=1)
    near = KDTree(mesh.vertices).query(middle, k=7)[1][:, 6]  # three or more are its own corners
    standing = np.stack([under[:, 0], under[:, 1], near], axis=1)
    standing = standing[(near != under[:, 0]) & (near != under[:, 1])]
    return replace(mesh, faces=np.concatenate([mesh.faces, twice, standing]))


def _with_triangles(made: Mesh, mesh: Mesh) -> Altered:
    return made, KDTree(made.vertices).query(mesh.vertices)[1]


def _long(mesh: Mesh, rng: np.random.Generator) -> Altered:
    axis = rng.standard_normal(3)
    made = with_long_triangles(mesh, 5000, stretch=rng.uniform(2, 5), axis=axis)
    return _with_triangles(made, mesh)


def _by_curvature(mesh: Mesh, rng: np.random.Generator) -> Altered:
    return _with_triangles(decimated(mesh, int(rng.uniform(2500, 6000))), mesh)


def _defective(mesh: Mesh, rng: np.random.Generator) -> Altered:
    made, index = _long(mesh, rng)
    return with_defects(made, 0.01, rng), index


def _welded(mesh: Mesh, rng: np.random.Generator) -> Altered:
    made = short_circuits(mesh, rng.uniform(0.005, 0.02), seed=int(rng.integers(2**31)))
    return made.mesh, made.vertex_index


def _all_at_once(mesh: Mesh, rng: np.random.Generator) -> Altered:
    long, index = _with_triangles(
        with_long_triangles(mesh, 5000, stretch=7.0, axis=rng.standard_normal(3)), mesh
    )
    welded = short_circuits(long, 0.02, seed=int(rng.integers(2**31)))
    return with_defects(welded.mesh, 0.02, rng), welded.vertex_index[index]


KINDS: dict[str, Callable[[Mesh, np.random.Generator], Altered]] = {
    "as it is": lambda mesh, rng: (mesh, np.arange(len(mesh.vertices))),
    "long": _long,
    "by curvature": _by_curvature,
    "defective": _defective,
    "welded": _welded,
    "all": _all_at_once,
}
"""Triangles two to five times as long along some direction; small where the surface bends, 2,500 to
6,000 vertices; the long ones with 1 % of the faces there twice and 1 % on an edge of two others;
limbs welded that are near each other, 0.5 to 2 % of the faces; and long by seven, welded by 2 % and
defective by 2 %.
"""


def altered(mesh: Mesh, kind: str, seed: int) -> Altered:
    """A mesh altered in one of `KINDS`."""
    return KINDS[kind](mesh, np.random.default_rng(seed))


def drawn_pairs(shapes: tuple[Shape, ...], count: int) -> list[tuple[Shape, Shape]]:
    """Pairs of shapes of different subjects, drawn at random."""
    pairs = [(a, b) for a in shapes for b in shapes if a.subject != b.subject]
    order = np.random.default_rng(0).permutation(len(pairs))[:count]
    return [pairs[i] for i in order.tolist()]


def errors(
    source: Shape, target: Shape, here: Altered, there: Altered, index: IntArray
) -> FloatArray:
    """Errors of a map between altered shapes, in per cent of √area; NaN where it matches nothing.

    Parameters
    ----------
    index
        Vertex of the altered target at each vertex of the altered source.
    """
    mesh = target.mesh()
    at_source, at_target = source.correspondence(), target.correspondence()
    points = np.flatnonzero((at_source >= 0) & (at_target >= 0))
    points = np.random.default_rng(0).permutation(points)[:POINTS]
    place = here[1][at_source[points]]
    image = np.where(place >= 0, index[place], -1)
    original = KDTree(mesh.vertices).query(there[0].vertices)[1]
    predicted = np.where(image >= 0, original[image], -1)
    (error,) = geodesic_errors(geodesic_graph(mesh), predicted, (at_target[points],))
    return np.where(np.isfinite(error), 100 * error / surface_area(mesh) ** 0.5, np.nan)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("model")
    parser.add_argument("dataset")
    parser.add_argument("include")
    parser.add_argument("--pairs", type=int, default=12)
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=list(KINDS))
    options = parser.parse_args()
    model, cache = load_model(options.model), default_cache()
    chosen = open_collection(options.dataset).including(options.include).shapes
    shapes = tuple(randomly_rotated(shape, seed=0) for shape in chosen)
    place = {shape.name: i for i, shape in enumerate(shapes)}
    pairs = drawn_pairs(shapes, options.pairs)
    print("| both shapes | mean | median of the pairs | worst pair | beyond 20 | verdicts |")
    print("|---|--:|--:|--:|--:|---|", flush=True)
    for kind in options.kinds:
        known: dict[str, tuple[Altered, Features]] = {}
        for shape in {shape.name: shape for pair in pairs for shape in pair}.values():
            made = altered(shape.mesh(), kind, place[shape.name])
            known[shape.name] = made, working_features(prepared(made[0]), model=model, cache=cache)
        means, far, verdicts = [], [], []
        for source, target in pairs:
            (here, first), (there, second) = known[source.name], known[target.name]
            found = match_features(first, second, model=model, cache=cache)
            error = errors(source, target, here, there, found.target_index)
            means.append(np.nanmean(error))
            far.append(np.mean(error[np.isfinite(error)] > FAR))
            verdicts.append(found.judgement.verdict)
            print(f"{kind} {source.name} {target.name} {means[-1]:.2f} {far[-1]:.3f}", flush=True)
        said = ", ".join(f"{verdicts.count(v)} {v}" for v in dict.fromkeys(verdicts))
        print(
            f"| {kind} | {np.mean(means):.2f} | {np.median(means):.2f} | {max(means):.2f} | "
            f"{np.mean(far):.2%} | {said} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
