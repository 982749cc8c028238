"""What the confidence expects of maps that are wrong: printed as the table of docs/robustness.md.

    python benchmarks/wrong_maps.py s10_p01,s12_p05 s11_p03,s13_p07

Maps between two of the bundled bodies: random ones, the nearest points after half a turn, ZoomOut
from random maps and from descriptors, and the true map. The confidence is that of `esd match` with
the default model, which never makes some of them.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator

import numpy as np

from esd.datasets.bodies import bodies
from esd.evaluation.errors import true_map
from esd.learning.model import load_model
from esd.matching import judge
from esd.matching.candidates import Candidate, Sampled, pair_descriptors, sampled
from esd.matching.confidence import confidence, judgement
from esd.matching.features import Features, shape_features
from esd.matching.refine import zoomout
from esd.mesh.geodesics import geodesic_diameter, geodesic_graph
from esd.mesh.mesh import Mesh
from esd.mesh.repair.repair import repair
from esd.nearest import nearest

SIZES = (8, 14, 20, 30, 45, 60, 100)
POINTS = 1000

Maps = tuple[np.ndarray, np.ndarray]
"""A map, and a map back."""


def wrong_maps(source: Features, target: Features, truth: Maps) -> Iterator[tuple[str, Maps]]:
    generator = np.random.default_rng(0)
    n, m = len(source.shape.vertices), len(target.shape.vertices)
    random = generator.integers(m, size=n), generator.integers(n, size=m)
    yield "random", random
    for name, flips in (("upside down", (1, -1, -1)), ("facing backwards", (-1, 1, -1))):
        moved, there = (f.positions - f.positions.mean(axis=0) for f in (source, target))
        moved = moved * flips * np.sqrt((there**2).sum() / m / ((moved**2).sum() / n))
        yield f"nearest points, {name}", (nearest(moved, there)[0], nearest(there, moved)[0])
    yield "ZoomOut from random", refined(source, target, random)
    for name in ("hks", "wks"):
        rows = [load_model(name).embed_mesh(f.shape) for f in (source, target)]
        start = nearest(*rows)[0], nearest(*rows[::-1])[0]
        yield f"nearest {name.upper()}", start
        yield f"ZoomOut from {name.upper()}", refined(source, target, start)
    yield "the true map", truth


def completed(truth: np.ndarray, mesh: Mesh) -> np.ndarray:
    """The same, where a vertex is no known point that of the nearest one which is."""
    known = np.flatnonzero(truth >= 0)
    return truth[known[nearest(mesh.vertices, mesh.vertices[known])[0]]]


def refined(source: Features, target: Features, start: Maps) -> Maps:
    spectra = source.spectrum, target.spectrum
    return (
        zoomout(*spectra, start[0], sizes=SIZES),
        zoomout(*spectra[::-1], start[1], sizes=SIZES),
    )


def expected(shapes: tuple[Sampled, Sampled], maps: Maps) -> tuple[float, str]:
    """The mean confidence of a map and its verdict, as for a candidate of `esd match`."""
    source, target = (each.features.shape for each in shapes)
    assert isinstance(source, Mesh)
    assert isinstance(target, Mesh)
    # rows whose nearest are the maps
    forward = (target.vertices[maps[0]], target.vertices)
    backward = (source.vertices, source.vertices[maps[1]])
    found = judge.evidence(
        *shapes, Candidate("given", forward, backward, None), pair_descriptors(*shapes)
    )
    values = confidence(source, target, *maps, accuracy=judge.accuracy(found))
    verdict = judgement(source, target, maps[0], values)
    return verdict.expected_accuracy, verdict.verdict


def main(pairs: list[str]) -> None:
    model, collection = load_model("default"), bodies()
    print("| pair | map | correct | expected | verdict |\n|---|---|--:|--:|---|")
    for pair in pairs:
        shapes = [collection[name] for name in pair.split(",")]
        meshes = [shape.mesh() for shape in shapes]
        here, there = (shape.correspondence() for shape in shapes)
        truth = (
            true_map(here, there, len(meshes[0].vertices)),
            true_map(there, here, len(meshes[1].vertices)),
        )
        features = [shape_features(repair(mesh), model=model) for mesh in meshes]
        samples = tuple(sampled(each) for each in features)
        known = np.flatnonzero(truth[0] >= 0)
        known = np.random.default_rng(0).choice(known, min(POINTS, len(known)), replace=False)
        away = geodesic_graph(meshes[1]).distances(truth[0][known])
        near = 0.05 * geodesic_diameter(meshes[1])
        complete = completed(truth[0], meshes[0]), completed(truth[1], meshes[1])
        for name, maps in wrong_maps(*features, complete):
            right = (away[np.arange(len(known)), maps[0][known]] <= near).mean()
            share, verdict = expected(samples, maps)
            print(f"| {pair} | {name} | {right:.0%} | {share:.0%} | {verdict} |", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
