"""Whether the confidence of a match is the share of such matches that are right.

    python benchmarks/confidence.py MODEL DATASET 'tr_reg_06[0-4],tr_reg_07[0-4]'

Matches of pairs of different subjects, by their confidence: how many there are, their mean
confidence, and the share within 5 % of the geodesic diameter of the truth, which should equal it.
Then each verdict, how often it was given, and the same for its maps.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from itertools import pairwise

import numpy as np

from esd.datasets.open import open_collection
from esd.evaluation.errors import geodesic_errors
from esd.learning.model import load_model
from esd.matching.match import match
from esd.mesh.geodesics import geodesic_diameter, geodesic_graph
from esd.spectral.cache import default_cache

EDGES = (0, 0.2, 0.4, 0.6, 0.8, 0.9, 0.95, 1.01)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("model")
    parser.add_argument("dataset")
    parser.add_argument("include")
    parser.add_argument("--pairs", type=int, default=20)
    options = parser.parse_args()
    model, cache = load_model(options.model), default_cache()
    every = open_collection(options.dataset).including(options.include).pairs()
    sure, right = [], []
    verdicts: dict[str, list[tuple[float, float]]] = defaultdict(list)
    for source, target in every[:: max(1, len(every) // options.pairs)][: options.pairs]:
        mesh = target.mesh()
        found = match(source.mesh(), mesh, model=model, cache=cache)
        graph = geodesic_graph(mesh)
        here, there = source.correspondence(), target.correspondence()
        known = (here >= 0) & (there >= 0)
        (error,) = geodesic_errors(graph, found.target_index[here[known]], (there[known],))
        within = error <= 0.05 * geodesic_diameter(mesh, graph=graph)
        sure.append(found.confidence[here[known]])
        right.append(within)
        if found.judgement:
            verdicts[found.judgement.verdict].append(
                (found.judgement.expected_accuracy, float(within.mean()))
            )
    confidence, truth = np.concatenate(sure), np.concatenate(right)
    print("| confidence | share of the matches | mean confidence | right |\n|---|--:|--:|--:|")
    for low, high in pairwise(EDGES):
        some = (confidence >= low) & (confidence < high)
        if some.any():
            print(
                f"| {low:g} to {min(high, 1):g} | {some.mean():.1%} | "
                f"{confidence[some].mean():.2f} | {truth[some].mean():.2f} |"
            )
    print(f"| all | 100.0% | {confidence.mean():.3f} | {truth.mean():.3f} |\n")
    print("| verdict | maps | expected | right |\n|---|--:|--:|--:|")
    for verdict, maps in verdicts.items():
        expected, actual = np.mean(maps, axis=0)
        print(f"| {verdict} | {len(maps)} | {expected:.3f} | {actual:.3f} |")


if __name__ == "__main__":
    main()
