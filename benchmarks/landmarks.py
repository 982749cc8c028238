"""Errors of maps with a few landmarks: exact ones, clicked some edges off, and one of them wrong.

    python benchmarks/landmarks.py default SMAL_R landmarks.csv --last 8

All ordered pairs of some shapes of a data set, each rotated at random. The landmarks are points of
the template, by farthest-point sampling on the first shape of the data set. 'Off' moves each of
them, on both shapes, to a random vertex three edges away; 'wrong' gives the third the target vertex
of another point, the farthest from its own. Errors are geodesic, over √area of the target,
times 100, at the points of the template. Each measured map is a row of the CSV file; rows that it
has are not measured again.
"""

from __future__ import annotations

import argparse
import csv
from itertools import permutations
from pathlib import Path

import numpy as np
from measure import row, rows_in, table
from scipy.sparse import csgraph
from scipy.spatial import KDTree

from esd.common import IntArray
from esd.datasets.collection import Shape
from esd.datasets.open import open_collection
from esd.evaluation.errors import vertex_errors
from esd.evaluation.protocol import randomly_rotated
from esd.learning.model import load_model
from esd.matching.features import Features
from esd.matching.match import match_features, prepared, working_features
from esd.mesh.geodesics import geodesic_graph
from esd.mesh.geometry import adjacency, edges
from esd.mesh.mesh import Mesh
from esd.mesh.sampling import sample_farthest
from esd.spectral.cache import default_cache

EDGES_OFF = 3
WRONG = 2  # the landmark that is wrong, from 0
SETTINGS = ("3", "5", "8", "3 off", "5 off", "8 off", "8, one wrong")
COLUMNS = ("source", "target", "landmarks", "mean", "median", "contradicted")


def moved(mesh: Mesh, vertices: IntArray, generator: np.random.Generator) -> IntArray:
    """A random vertex some edges away from each."""
    graph = adjacency(edges(mesh), len(mesh.vertices))
    hops = csgraph.dijkstra(graph, unweighted=True, indices=vertices, limit=EDGES_OFF)
    return np.array([generator.choice(np.flatnonzero(each == EDGES_OFF)) for each in hops])


def landmarks_of(
    setting: str, meshes: list[Mesh], points: list[IntArray], chosen: IntArray, seed: int
) -> IntArray:
    """Pairs of vertices, (l, 2), of the first of the chosen points, as the setting has it."""
    pairs = np.stack([each[chosen[: int(setting[0])]] for each in points], axis=1)
    generator = np.random.default_rng(seed)
    if setting.endswith("off"):
        columns = zip(meshes, pairs.T, strict=True)
        pairs = np.stack([moved(*each, generator) for each in columns], axis=1)
    elif setting.endswith("wrong"):
        distance = geodesic_graph(meshes[1]).distances(pairs[[WRONG], 1])[0, points[1]]
        pairs[WRONG, 1] = points[1][np.argmax(np.where(np.isfinite(distance), distance, -1.0))]
    return pairs


def summary(rows: list[dict[str, str]], settings: list[str]) -> None:
    """Print a line for each setting."""
    table("landmarks", "maps", "mean error", "median of maps", "worst map", "contradicted")
    for setting in settings:
        found = [each for each in rows if each["landmarks"] == setting]
        if not found:
            continue
        means = np.array([float(each["mean"]) for each in found])
        named = sum(each["contradicted"] == str(WRONG) for each in found)
        others = sum(each["contradicted"] not in ("", str(WRONG)) for each in found)
        row(
            *(setting, len(found), f"{means.mean():.2f}"),
            *(f"{np.median(means):.2f}", f"{means.max():.2f}"),
            f"the third alone {named}, others {others}",
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("model")
    parser.add_argument("dataset")
    parser.add_argument("csv", type=Path)
    parser.add_argument("--include", default="*")
    parser.add_argument("--last", type=int, help="only the last shapes")
    parser.add_argument("--pairs", type=int, help="only some pairs, drawn by the seed")
    parser.add_argument("--settings", nargs="+", choices=SETTINGS, default=list(SETTINGS))
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    model = load_model(options.model)
    collection = open_collection(options.dataset)
    first = collection.shapes[0]
    place = first.correspondence()
    farthest = sample_farthest(first.mesh(), 8, seed=0)
    # not every vertex is a point of the template
    chosen = KDTree(first.mesh().vertices[place]).query(first.mesh().vertices[farthest])[1]
    shapes = collection.including(options.include).shapes
    shapes = shapes[-options.last :] if options.last else shapes
    pairs = list(permutations(range(len(shapes)), 2))
    np.random.default_rng(options.seed).shuffle(pairs)
    done = rows_in(options.csv, COLUMNS)
    known = {(each["source"], each["target"], each["landmarks"]) for each in done}

    def described(number: int) -> tuple[Mesh, IntArray, Features]:
        shape: Shape = randomly_rotated(shapes[number], seed=options.seed)
        work = prepared(shape.mesh())
        features = working_features(work, model=model, cache=default_cache())
        return shape.mesh(), shape.correspondence(), features

    held: dict[int, tuple[Mesh, IntArray, Features]] = {}
    for number, pair in enumerate(pairs[: options.pairs]):
        names = [shapes[each].name for each in pair]
        for setting in options.settings:
            if (*names, setting) in known:
                continue
            for each in pair:
                held[each] = held.get(each) or described(each)
            meshes, points, features = zip(*(held[each] for each in pair), strict=True)
            given = landmarks_of(setting, meshes, points, chosen, options.seed + number)
            found = match_features(*features, model=model, landmarks=given)
            errors = 100 * vertex_errors(meshes[1], found.target_index[points[0]], points[1])
            named = " ".join(map(str, found.judgement.contradicted)) if found.judgement else ""
            figures = f"{np.nanmean(errors):.3f}", f"{np.nanmedian(errors):.3f}"
            with options.csv.open("a", newline="") as file:
                csv.writer(file).writerow((*names, setting, *figures, named))
    with options.csv.open(newline="") as file:
        summary(list(csv.DictReader(file)), options.settings)


if __name__ == "__main__":
    main()
