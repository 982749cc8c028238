"""How a model's maps depend on the triangles of both meshes: each kind against each.

    python benchmarks/triangulations.py MODEL DATASET 'tr_reg_06[0-4],tr_reg_07[5-9]' --pairs 3

Rows are sources, columns targets. Each cell is the mean geodesic error over the square root of the
area, times 100, refined, and how many times the mean of the two where both meshes have the source's
kind of triangles, and both the target's.
Needs fast-simplification, which `pip install '.[dev]'` brings.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from itertools import product

import numpy as np
from real_triangles import decimated
from robustness import stretched
from scipy.spatial import KDTree

from esd.datasets.collection import Shape
from esd.datasets.open import open_collection
from esd.evaluation.protocol import evaluate
from esd.learning.model import load_model
from esd.mesh.mesh import Mesh
from esd.mesh.remesh.remesh import remesh
from esd.mesh.shapes import subdivide
from esd.spectral.cache import default_cache

KINDS = {
    "even, 5,000": lambda mesh: remesh(mesh, 5000, style="even", seed=0).mesh,
    "long, 5,000": stretched,
    "by curvature, 3,000": lambda mesh: decimated(mesh, 3000),
    "dense, 20,000": subdivide,
    "coarse, 2,500": lambda mesh: remesh(mesh, 2500, style="even", seed=0).mesh,
}


def retriangulated(shape: Shape, made: Mesh, *, kind: str) -> Shape:
    """The shape with other triangles, whose points go to the nearest vertices."""
    index = shape.correspondence()
    _, nearest = KDTree(made.vertices).query(shape.mesh().vertices)
    moved = np.where(index >= 0, nearest[index], -1)
    return replace(
        shape,
        name=f"{shape.name}, {kind}",
        mesh=lambda: made,
        correspondence=lambda: moved,
        symmetric=None,
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("model")
    parser.add_argument("dataset")
    parser.add_argument("include")
    parser.add_argument("--pairs", type=int, default=3)
    options = parser.parse_args()
    model, cache = load_model(options.model), default_cache()
    every = open_collection(options.dataset).including(options.include).pairs()
    pairs = every[:: max(1, len(every) // options.pairs)][: options.pairs]
    shapes = {shape.name: shape for pair in pairs for shape in pair}
    made = {
        (kind, name): retriangulated(shape, alter(shape.mesh()), kind=kind)
        for kind, alter in KINDS.items()
        for name, shape in shapes.items()
    }
    errors = np.zeros((len(KINDS), len(KINDS)))
    for (i, here), (j, there) in product(enumerate(KINDS), repeat=2):
        chosen = [(made[here, source.name], made[there, target.name]) for source, target in pairs]
        result, _ = evaluate(model, chosen, refine=True, cache=cache)
        errors[i, j] = result.mean_geodesic_error_x100
    print(f"| source \\ target | {' | '.join(KINDS)} |\n|---|{'--:|' * len(KINDS)}")
    equal = np.diag(errors)
    relative = errors / ((equal[:, None] + equal) / 2)
    for kind, row, ratios in zip(KINDS, errors, relative, strict=True):
        cells = (f"{e:.2f} ({r:.2f})" for e, r in zip(row, ratios, strict=True))
        print(f"| {kind} | {' | '.join(cells)} |")


if __name__ == "__main__":
    main()
