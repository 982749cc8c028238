"""Errors of maps by a model as it is, and adapted to each pair without correspondences.

    python benchmarks/adapt.py default SMAL_R adapt.csv --last 8 --pairs 16

Some ordered pairs of the last shapes of a data set, drawn by the seed, each shape rotated at
random. Errors are geodesic, over √area of the target, times 100, at the points of the template. The
costs are the judge's, see `esd.matching.confidence.Adaptation`. Each pair is a row of the CSV file;
pairs that it has are not measured again.
"""

from __future__ import annotations

import argparse
import csv
import time
from itertools import permutations
from pathlib import Path

import numpy as np
from measure import row, rows_in, table

from esd.datasets.collection import Shape
from esd.datasets.open import open_collection
from esd.evaluation.errors import vertex_errors
from esd.evaluation.protocol import randomly_rotated
from esd.learning.model import load_model
from esd.matching.match import match_features, prepared, working_features
from esd.spectral.cache import default_cache

COLUMNS = ("source", "target", "plain", "adapted", "before", "after", "kept", "cpu")


def error(source: Shape, target: Shape, index: np.ndarray) -> float:
    """Mean error of a map at the points of the template, times 100."""
    points = source.correspondence()
    predicted = np.where(points >= 0, index[points], -1)
    errors = vertex_errors(target.mesh(), predicted, target.correspondence())
    return 100 * float(errors[np.isfinite(errors)].mean())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("model")
    parser.add_argument("dataset")
    parser.add_argument("csv", type=Path)
    parser.add_argument("--include", default="*")
    parser.add_argument("--last", type=int, help="only the last shapes")
    parser.add_argument("--pairs", type=int, help="only some pairs, drawn by the seed")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    model = load_model(options.model)
    shapes = open_collection(options.dataset).including(options.include).shapes
    shapes = shapes[-options.last :] if options.last else shapes
    pairs = list(permutations(shapes, 2))
    np.random.default_rng(options.seed).shuffle(pairs)
    known = {(each["source"], each["target"]) for each in rows_in(options.csv, COLUMNS)}
    for pair in pairs[: options.pairs]:
        names = tuple(shape.name for shape in pair)
        if names in known:
            continue
        rotated = [randomly_rotated(shape, seed=options.seed) for shape in pair]
        features = [
            working_features(prepared(shape.mesh()), model=model, cache=default_cache())
            for shape in rotated
        ]
        plain = match_features(*features, model=model)
        start = time.process_time()
        found = match_features(*features, model=model, adapt=True, cache=default_cache())
        cpu = time.process_time() - start
        adaptation = found.judgement.adaptation
        figures = [error(*rotated, each.target_index) for each in (plain, found)]
        figures += [adaptation.cost_before, adaptation.cost_after]
        with options.csv.open("a", newline="") as file:
            values = *(f"{each:.3f}" for each in figures), adaptation.is_kept, f"{cpu:.1f}"
            csv.writer(file).writerow((*names, *values))
    rows = rows_in(options.csv, COLUMNS)
    table("map", "pairs", "mean error", "median of maps", "worst map")
    for name in ("plain", "adapted"):
        errors = np.array([float(each[name]) for each in rows])
        figures = (errors.mean(), np.median(errors), errors.max())
        row(name, len(rows), *(f"{each:.2f}" for each in figures))
    better = sum(float(each["adapted"]) < float(each["plain"]) for each in rows)
    kept = sum(each["kept"] == "True" for each in rows)
    print(f"kept {kept}, of all maps {better} better than by the model as it is")


if __name__ == "__main__":
    main()
