"""What the judge expects of maps between points without faces: fitted, and printed as a table.

    python benchmarks/points.py                  # fits the weights to bodies of training, tests
    python benchmarks/points.py FAUST_R --pairs tr_reg_060,tr_reg_071 tr_reg_065,tr_reg_073

The points are the vertices of two shapes, turned at random, whose faces are not looked at. Maps are
those of models for points, the truth, the truth with jitter, and wrong ones: the truth mirrored,
with one leg or half of the body mirrored, nearest points in wrong poses, random ones. A map is
right at a point within 5 % of the geodesic diameter of the truth.
"""

from __future__ import annotations

import argparse
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields

import numpy as np
from measure import row, table
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from esd.common import FloatArray, IntArray
from esd.datasets.collection import Collection, Shape
from esd.datasets.deformation import deformed
from esd.datasets.open import open_collection
from esd.evaluation.errors import geodesic_errors
from esd.learning.model import load_model
from esd.matching import points
from esd.matching.confidence import Judgement, confidence, judgement
from esd.matching.features import Features, shape_features
from esd.matching.judge import Evidence
from esd.matching.match import match_features, prepared
from esd.mesh.geodesics import geodesic_diameter, geodesic_graph
from esd.mesh.mesh import Mesh, PointCloud
from esd.mesh.repair.repair import Repaired

FITTED = [
    f"s0{i}_p0{(3 * i + j) % 9},s0{(i + 1 + j) % 9}_p0{(i + 5 * j) % 9}"
    for i in range(8)
    for j in range(2)
]
TESTED = ["s10_p01,s12_p05", "s11_p03,s11_p06", "s12_p02,s13_p02", "s13_p04,s10_p08"]
NAMES = [field.name for field in fields(Evidence)]
USED = [
    "round_trip",
    "lost",
    "stretch",
    "torn",
    "orientation",
    "uncovered",
    "commutator",
    "distances",
]
STRAINS = (0.0, 0.2, 0.4)
REGULARISATION = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class Tried:
    """A map with what the judge sees of it."""

    name: str
    right: float
    evidence: Evidence
    index: IntArray
    back: IntArray
    shapes: Sequence[Features]

    def judgement(self) -> Judgement:
        """As `esd match` judges."""
        expected = points.accuracy_of_points(self.evidence)
        ends = [each.shape for each in self.shapes]
        values = confidence(*ends, self.index, self.back, accuracy=expected)
        return judgement(*ends, self.index, values)


def cloud(mesh: Mesh, name: str) -> Repaired:
    turn = Rotation.random(random_state=zlib.crc32(name.encode()) % 2**31).as_matrix()
    return prepared(PointCloud(mesh.vertices @ turn.T))


def everywhere(mesh: Mesh, known: IntArray) -> IntArray:
    """The nearest point of the template to each vertex."""
    return np.asarray(KDTree(mesh.vertices[known]).query(mesh.vertices)[1])


def maps(
    source: Shape, target: Shape, meshes: tuple[Mesh, Mesh]
) -> Iterator[tuple[str, IntArray, IntArray]]:
    """Maps between all vertices, and maps back."""
    generator = np.random.default_rng(zlib.crc32((source.name + target.name).encode()))
    here, there = source.correspondence(), target.correspondence()
    at, back = everywhere(meshes[0], here), everywhere(meshes[1], there)
    truth = there[at], here[back]
    yield "truth", *truth
    near = [KDTree(mesh.vertices).query(mesh.vertices, k=12)[1] for mesh in meshes]
    n, m = (len(mesh.vertices) for mesh in meshes)
    yield (
        "truth, up to 12 neighbours off",
        near[1][truth[0], generator.integers(12, size=n)],
        near[0][truth[1], generator.integers(12, size=m)],
    )
    if source.symmetric is not None and target.symmetric is not None:
        mirrored = target.symmetric()[at], source.symmetric()[back]
        yield "mirrored", *mirrored
        for axis, share in ((2, 0.4), (1, 0.4), (1, 0.7)):
            low = [
                mesh.vertices[:, axis] < np.quantile(mesh.vertices[:, axis], share)
                for mesh in meshes
            ]
            yield (
                f"mirrored below {share:.0%} of axis {axis}",
                np.where(low[0], mirrored[0], truth[0]),
                np.where(low[1], mirrored[1], truth[1]),
            )
    centred = [mesh.vertices - mesh.vertices.mean(axis=0) for mesh in meshes]
    for name, flips in (
        ("nearest points", (1, 1, 1)),
        ("nearest points, upside down", (1, -1, -1)),
        ("nearest points, facing backwards", (-1, 1, -1)),
    ):
        moved = centred[0] * flips
        yield name, KDTree(centred[1]).query(moved)[1], KDTree(moved).query(centred[1])[1]
    yield "random", generator.integers(m, size=n), generator.integers(n, size=m)


def tried(source: Shape, target: Shape, *, strain: float) -> Iterator[Tried]:
    meshes = source.mesh(), target.mesh()
    if strain:
        seed = zlib.crc32(target.name.encode())
        meshes = meshes[0], deformed(meshes[1], seed=seed, strain=strain)
    clouds = cloud(meshes[0], "source" + source.name), cloud(meshes[1], target.name)
    model = load_model("wks")
    shapes = [shape_features(each, model=model) for each in clouds]
    surfaces = [points.with_surface(each) for each in shapes]
    known, truth = source.correspondence(), target.correspondence()
    graph, size = geodesic_graph(meshes[1]), geodesic_diameter(meshes[1])

    def right(index: IntArray) -> float:
        return float((geodesic_errors(graph, index[known], (truth,))[0] <= 0.05 * size).mean())

    def seen(name: str, index: IntArray, back: IntArray) -> Tried:
        # from the files' vertices to the points, of which equal ones are one
        forward = clouds[1].vertex_index[index[clouds[0].original_index]]
        backward = clouds[0].vertex_index[back[clouds[1].original_index]]
        return Tried(
            name,
            right(index),
            points.evidence_of_points(*surfaces, forward, backward),
            forward,
            backward,
            surfaces,
        )

    for name, index, back in maps(source, target, meshes):
        yield seen(name, index, back)
    for name in ("hks", "wks"):
        for refine in (False, True):
            model = load_model(name)
            ends = [shape_features(each, model=model) for each in clouds]
            ways = [
                match_features(*each, model=model, refine=refine).target_index
                for each in (ends, ends[::-1])
            ]
            yield seen(name + (", refined" if refine else ""), *ways)


def weights(rows: list[Tried]) -> tuple[FloatArray, float]:
    """Weights and constant of a logistic regression of the share that is right."""
    used = [NAMES.index(name) for name in USED]
    values = np.array([each.evidence.vector() for each in rows])[:, used]
    share = np.array([each.right for each in rows])
    mean, deviation = values.mean(axis=0), values.std(axis=0)
    design = np.hstack([np.ones((len(rows), 1)), (values - mean) / deviation])
    penalty = REGULARISATION * np.eye(design.shape[1])
    penalty[0, 0] = 0.0
    found = np.zeros(design.shape[1])
    for _ in range(50):  # Newton's method
        expected = 1 / (1 + np.exp(-design @ found))
        slope = design.T @ (expected - share) + penalty @ found
        curvature = (design * (expected * (1 - expected))[:, None]).T @ design + penalty
        found -= np.linalg.solve(curvature, slope)
    factors = np.zeros(len(NAMES))
    factors[used] = found[1:] / deviation
    return factors, float(found[0] - mean @ factors[used])


def pairs(collection: Collection, names: list[str]) -> Iterator[tuple[Shape, Shape]]:
    for pair in names:
        source, target = (collection[name] for name in pair.split(","))
        yield source, target


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("dataset", nargs="?", default="bodies")
    parser.add_argument(
        "--pairs", nargs="+", help="SOURCE,TARGET; without them, weights are fitted"
    )
    options = parser.parse_args()
    collection = open_collection(options.dataset)
    if options.pairs is None:
        rows = [
            each
            for number, ends in enumerate(pairs(collection, FITTED))
            for each in tried(*ends, strain=STRAINS[number % len(STRAINS)])
        ]
        factors, constant = weights(rows)
        print(
            "weights:", ", ".join(f"{value:.3f}" for value in factors), f"constant {constant:.3f}"
        )
        points._WEIGHTS, points._CONSTANT = tuple(factors), constant
    rows = [
        each
        for ends in pairs(collection, options.pairs or TESTED)
        for each in tried(*ends, strain=0.0)
    ]
    table("map", "right", "expected", "verdicts")
    judged = [(each, each.judgement()) for each in rows]
    for name in dict.fromkeys(each.name for each in rows):
        some = [both for both in judged if both[0].name == name]
        row(
            name,
            " ".join(f"{each.right:.0%}" for each, _ in some),
            " ".join(f"{found.expected_accuracy:.0%}" for _, found in some),
            " ".join(found.verdict for _, found in some),
        )
    error = np.mean([abs(each.right - found.expected_accuracy) for each, found in judged])
    print(f"\nmean difference of right and expected: {error:.3f}")


if __name__ == "__main__":
    main()
