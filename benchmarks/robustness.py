"""How a model's maps change with what should not matter: triangles, place, scale, order, noise.

    python benchmarks/robustness.py MODEL DATASET 'tr_reg_06[0-4],tr_reg_07[0-4]'

Each target of the pairs of different subjects is altered, the source stays as it is. The second
figure of each line is the mean geodesic error beside that of the unaltered targets. Errors are
measured at some points of each pair, drawn at random, which saves most of the time.
Needs fast-simplification, which `pip install '.[dev]'` brings.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import fast_simplification
import numpy as np
from scipy.spatial import cKDTree

from esd.common import IntArray
from esd.datasets.collection import Shape
from esd.datasets.open import open_collection
from esd.evaluation.protocol import evaluate
from esd.learning.model import load_model
from esd.matching.match import match
from esd.mesh.mesh import Mesh, edge_lengths, surface_area
from esd.mesh.remesh import remesh
from esd.mesh.shapes import subdivide
from esd.spectral.cache import default_cache

Alter = Callable[[Mesh], Mesh]
"""The altered mesh."""


def rotated(mesh: Mesh) -> Mesh:
    rotation, _ = np.linalg.qr(np.random.default_rng(0).standard_normal((3, 3)))
    return replace(mesh, vertices=mesh.vertices @ (rotation * np.linalg.det(rotation)))


def noisy(mesh: Mesh) -> Mesh:
    step = 0.3 * edge_lengths(mesh).mean()
    shift = np.random.default_rng(0).standard_normal(mesh.vertices.shape) * step / np.sqrt(3)
    return replace(mesh, vertices=mesh.vertices + shift)


def decimated(mesh: Mesh, count: int) -> Mesh:
    """By quadric error metrics: fewer triangles where the surface is flat."""
    scale = np.sqrt(surface_area(mesh))
    faces = round(2 * count)
    vertices, faces = fast_simplification.simplify(
        (mesh.vertices / scale).astype(np.float32),
        mesh.faces.astype(np.int32),
        target_count=faces,
    )
    return Mesh(vertices.astype(float) * scale, faces)


def stretched(mesh: Mesh) -> Mesh:
    """Long triangles: the surface is decimated while it is four times as tall."""
    tall = np.array([1, 4, 1]) if np.ptp(mesh.vertices, axis=0).argmax() == 1 else [1, 1, 4]
    made = decimated(subdivide(replace(mesh, vertices=mesh.vertices * tall)), 5000)
    return replace(made, vertices=made.vertices / tall)


def third_turned(mesh: Mesh) -> Mesh:
    turned = np.random.default_rng(0).random((len(mesh.faces), 1)) < 1 / 3
    return replace(mesh, faces=np.where(turned, mesh.faces[:, ::-1], mesh.faces))


ALTERATIONS: dict[str, Alter] = {
    "as it is": lambda mesh: mesh,
    "triangles: even, 5,000 vertices": lambda mesh: remesh(mesh, 5000, style="even", seed=0).mesh,
    "triangles: long, 5,000 (library)": stretched,
    "triangles: by curvature, 3,000 (library)": lambda mesh: decimated(mesh, 3000),
    "triangles: dense, 20,000 (each in four)": subdivide,
    "triangles: coarse, 2,500": lambda mesh: remesh(mesh, 2500, style="even", seed=0).mesh,
    "triangles: 15,000": lambda mesh: remesh(mesh, 15_000, style="even", seed=0).mesh,
    "rotated": rotated,
    "scaled by 0.2": lambda mesh: replace(mesh, vertices=0.2 * mesh.vertices),
    "scaled by 4": lambda mesh: replace(mesh, vertices=4 * mesh.vertices),
    "noise of 0.3 mean edges": noisy,
    "a third of the faces turned": third_turned,
    "inside out": lambda mesh: replace(mesh, faces=mesh.faces[:, ::-1]),
}


def altered(shape: Shape, alter: Alter, *, other_vertices: bool) -> Shape:
    """The shape with an altered mesh, whose points go to the nearest vertices if it has others."""
    mesh, index = shape.mesh(), shape.correspondence()
    made = alter(mesh)
    nearest = np.arange(len(mesh.vertices))
    if other_vertices:
        _, nearest = cKDTree(made.vertices).query(mesh.vertices)
    moved = np.where(index >= 0, nearest[index], -1)
    return replace(
        shape,
        name=f"{shape.name}, altered",
        mesh=lambda: made,
        correspondence=lambda: moved,
        symmetric=None,
    )


def shuffled(shape: Shape) -> Shape:
    mesh, index = shape.mesh(), shape.correspondence()
    order = np.random.default_rng(0).permutation(len(mesh.vertices))
    place = np.argsort(order)
    made = Mesh(mesh.vertices[order], place[mesh.faces])
    moved = np.where(index >= 0, place[index], -1)
    return replace(
        shape,
        name=f"{shape.name}, shuffled",
        mesh=lambda: made,
        correspondence=lambda: moved,
        symmetric=None,
    )


def some_points(shape: Shape, count: int) -> Shape:
    """The shape with some points of its template alone, the same of each shape."""

    def correspondence() -> IntArray:
        index = shape.correspondence()
        dropped = np.random.default_rng(0).permutation(len(index))[count:]
        return np.where(np.isin(np.arange(len(index)), dropped), -1, index)

    return replace(shape, correspondence=correspondence, symmetric=None)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("model")
    parser.add_argument("dataset")
    parser.add_argument("include")
    parser.add_argument("--pairs", type=int, default=12)
    parser.add_argument("--points", type=int, default=1000)
    options = parser.parse_args()
    model, cache = load_model(options.model), default_cache()
    every = open_collection(options.dataset).including(options.include).pairs()
    pairs = [
        (some_points(source, options.points), target)
        for source, target in every[:: max(1, len(every) // options.pairs)][: options.pairs]
    ]
    clean: dict[bool, float] = {}
    print("| target | nearest neighbour | to clean | refined | to clean |\n|---|--:|--:|--:|--:|")
    changes = {
        name: partial(altered, alter=alter, other_vertices=name.startswith("triangles"))
        for name, alter in ALTERATIONS.items()
    }
    for name, change in {**changes, "vertices shuffled": shuffled}.items():
        targets = {target.name: change(target) for _, target in pairs}
        cells = []
        for refine in (False, True):
            result, _ = evaluate(
                model,
                [(source, targets[target.name]) for source, target in pairs],
                refine=refine,
                cache=cache,
            )
            error = result.mean_geodesic_error_x100
            cells += [f"{error:.2f}", f"{error / clean.setdefault(refine, error):.2f}"]
        print(f"| {name} | {' | '.join(cells)} |", flush=True)
    print("\nVerdicts of `match`:")
    for name, spoil in {
        "as it is": lambda mesh: mesh,
        "mirrored, faces as they were": lambda mesh: replace(
            mesh, vertices=mesh.vertices * [-1, 1, 1]
        ),
        "inside out": ALTERATIONS["inside out"],
        "a third of the faces turned": third_turned,
    }.items():
        verdicts = Counter(
            found.judgement.verdict
            for found in (
                match(source.mesh(), spoil(target.mesh()), model=model, cache=cache)
                for source, target in pairs
            )
            if found.judgement
        )
        print(f"- {name}: {dict(verdicts)}", flush=True)


if __name__ == "__main__":
    main()
