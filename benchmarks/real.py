"""Real shapes of many kinds, randomly rotated: `esd.match` beside what one would do without it.

    python benchmarks/real.py DATA --output real.csv
    python benchmarks/real.py DATA --output real.csv --sets skulls hands --pairs 10
    python benchmarks/real.py DATA --output real.csv --methods esd icp nearest pyfm

DATA is a folder of data sets as `SETS` lists them. Rows are appended to the file as they are
measured, and those that it has are not measured again; `--again esd` measures a method anew, on
the sets of `--sets`.
Errors are distances to the true point in per cent of the diagonal of the target's bounding box,
and geodesic ones × 100 over √area. Where no truth is known, the source is brought to the target by
the affine map that fits its matches best, and the error is the mean distance of both surfaces to
the nearest vertex of the other. 'Right' is the share within 5 % of the geodesic diameter.
"""

from __future__ import annotations

import argparse
import csv
import tempfile
import time
import zlib
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields
from functools import lru_cache
from itertools import permutations, product
from pathlib import Path

import numpy as np
from measure import cost, job, row, table
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

import esd
from esd.common import FloatArray, InputError, IntArray
from esd.datasets.open import open_collection
from esd.evaluation.errors import geodesic_errors
from esd.learning.model import load_model
from esd.matching.features import shape_features
from esd.mesh.geodesics import EdgeGraph, geodesic_diameter, geodesic_graph
from esd.mesh.geometry import surface_area
from esd.mesh.io.meshes import read_mesh, write_mesh
from esd.mesh.mesh import Mesh
from esd.mesh.repair.repair import repair
from esd.nearest import nearest
from esd.spectral.cache import default_cache

POINTS = 1000  # at which errors are measured, at the most


@dataclass(frozen=True, slots=True, eq=False)
class Shape:
    """A mesh, and its vertex and position at each point that all shapes of its kind have.

    Parameters
    ----------
    index : (p,)
        -1 where the shape lacks the point; empty where no truth is known.
    points : (p, 3)
        The exact position, which need not be that of a vertex.
    """

    name: str
    kind: str
    mesh: Mesh
    index: IntArray
    points: FloatArray


@dataclass(frozen=True, slots=True)
class Row:
    """What one method made of one pair; empty where it does not apply."""

    set: str
    source: str
    target: str
    method: str
    error: float | str = ""
    median: float | str = ""
    geodesic: float | str = ""
    right: float | str = ""
    unmatched: float | str = ""
    seconds: float | str = ""
    verdict: str = ""
    expected: float | str = ""
    failure: str = ""


# --- the sets ---


def at_vertices(name: str, mesh: Mesh, index: IntArray, kind: str = "") -> Shape:
    return Shape(name, kind, mesh, index, mesh.vertices[index])


def vertex_for_vertex(*files: Path) -> list[Shape]:
    """Meshes whose vertices of one number are the same point."""
    meshes = [read_mesh(file) for file in files]
    return [
        at_vertices(file.stem, mesh, np.arange(len(mesh.vertices)))
        for file, mesh in zip(files, meshes, strict=True)
    ]


def with_landmarks(files: list[Path], landmarks: Callable[[Path], Path]) -> list[Shape]:
    shapes = []
    for file in files:
        mesh = read_mesh(file)
        text = landmarks(file).read_text(encoding="utf-8").splitlines()
        points = np.array([[float(x) for x in line.split(",")[1:4]] for line in text[1:]])
        index = KDTree(mesh.vertices).query(points)[1]
        shapes.append(Shape(file.stem, "", mesh, index, points))
    return shapes


def registered(folder: Path) -> list[Shape]:
    """A data set with `.vts` files; shapes of one template correspond."""
    return [
        at_vertices(shape.name, shape.mesh(), shape.correspondence(), shape.template)
        for shape in open_collection(folder).shapes
    ]


def heads(folder: Path) -> list[Shape]:
    """Heads of one connectivity, and a decimated copy of one: its points by position."""
    whole = vertex_for_vertex(*sorted(folder.glob("h*.ply")))
    copy = read_mesh(folder / "d01.ply")
    original = next(shape.mesh for shape in whole if shape.name == "h01")
    index = KDTree(copy.vertices).query(original.vertices)[1]
    return [*whole, Shape("d01", "", copy, index, original.vertices)]


def without_truth(folder: Path) -> list[Shape]:
    return [
        Shape(file.stem, "", read_mesh(file), np.zeros(0, dtype=int), np.zeros((0, 3)))
        for file in sorted(folder.glob("*.ply"))
    ]


SETS: dict[str, Callable[[Path], list[Shape]]] = {
    "skulls": lambda folder: with_landmarks(
        sorted((folder / "shapes").glob("*.ply")),
        lambda file: folder / "landmarks" / f"{file.stem}.csv",
    ),
    "heads": heads,
    "brains": lambda folder: vertex_for_vertex(*sorted(folder.glob("*.ply"))),
    "teeth": without_truth,
    "hands": lambda folder: vertex_for_vertex(folder / "left.glb", folder / "right.glb"),
    "endocasts": lambda folder: with_landmarks(
        sorted(folder.glob("*.ply")), lambda file: file.with_suffix(".csv")
    ),
    "artists": lambda folder: vertex_for_vertex(*sorted(folder.glob("*.obj"))),
    "smal_r": registered,
    "tosca_r": registered,
    "faust_r": registered,
}


def rotated(shape: Shape) -> Shape:
    """The shape rotated at random by its name, the same in all pairs."""
    turn = Rotation.random(random_state=zlib.crc32(shape.name.encode())).as_matrix()
    mesh = Mesh(shape.mesh.vertices @ turn.T, shape.mesh.faces)
    return Shape(shape.name, shape.kind, mesh, shape.index, shape.points @ turn.T)


def pairs_of(shapes: list[Shape], count: int | None, seed: int) -> list[tuple[Shape, Shape]]:
    every = [(s, t) for s, t in permutations(shapes, 2) if s.kind == t.kind]
    if count is None or count >= len(every):
        return every
    return [every[i] for i in np.random.default_rng(seed).permutation(len(every))[:count]]


# --- the methods: each gives the target vertex of each source vertex, -1 for none ---


def by_esd(source: Mesh, target: Mesh) -> tuple[IntArray, str, float | str]:
    found = esd.match(source, target)
    said = found.judgement
    if said is None:
        return found.target_index, "", ""
    return found.target_index, said.verdict, said.expected_accuracy


def by_nearest(source: Mesh, target: Mesh) -> tuple[IntArray, str, float | str]:
    """Nearest rows of the default model's embedding, without refinement."""
    model = load_model("default")
    here, there = (
        shape_features(repair(mesh, restore=True), model=model, cache=default_cache())
        for mesh in (source, target)
    )
    index, _ = nearest(here.embedded, there.embedded)
    known = here.vertex_index >= 0
    original = there.original_index[index[here.vertex_index]]
    return np.where(known, original, -1), "", ""


def by_icp(source: Mesh, target: Mesh) -> tuple[IntArray, str, float | str]:
    """Affine ICP from all ways to lay principal axes on principal axes; the nearest vertex."""
    sets = []
    for mesh in (source, target):
        points = mesh.vertices[np.unique(mesh.faces)]
        centred = points - points.mean(axis=0)
        scale = np.sqrt((centred**2).sum(axis=1).mean())
        axes = np.linalg.svd(centred, full_matrices=False)[2]
        axes *= np.linalg.det(axes)
        every = (mesh.vertices - points.mean(axis=0)) / scale @ axes.T
        sets.append((every, centred / scale @ axes.T))
    (every, here), (every_there, there) = sets
    some, there_some = (
        p[np.random.default_rng(0).permutation(len(p))[:1500]] for p in (here, there)
    )
    flips = [
        np.eye(3)[list(order)] * signs
        for order, signs in product(permutations(range(3)), product((1, -1), repeat=3))
    ]
    starts = [np.vstack([flip, np.zeros(3)]) for flip in flips if np.linalg.det(flip) > 0]
    rough = [affine_icp(some, there_some, start, steps=30) for start in starts]
    map_, _ = affine_icp(here, there, min(rough, key=lambda found: found[1])[0], steps=30)
    return KDTree(every_there).query(homogeneous(every) @ map_)[1], "", ""


def homogeneous(points: FloatArray) -> FloatArray:
    return np.hstack([points, np.ones((len(points), 1))])


def affine_icp(
    source: FloatArray, target: FloatArray, map_: FloatArray, *, steps: int
) -> tuple[FloatArray, float]:
    """An affine map (4, 3), fitted to nearest points both ways, so that it does not shrink."""
    rows, tree = homogeneous(source), KDTree(target)
    residual = np.inf
    for step in range(steps):
        moved = rows @ map_
        there, index = tree.query(moved)
        back, where = KDTree(moved).query(target)
        residual = float(np.mean(there) + np.mean(back))
        if step < 10:  # first a rotation and a scale
            a, b = np.concatenate([source, source[where]]), np.concatenate([target[index], target])
            map_ = similarity(a, b)
        else:
            map_ = np.linalg.lstsq(
                np.concatenate([rows, rows[where]]),
                np.concatenate([target[index], target]),
                rcond=None,
            )[0]
    return map_, residual


def similarity(a: FloatArray, b: FloatArray) -> FloatArray:
    """The rotation, scale and shift (4, 3) that bring points a to b."""
    mean_a, mean_b = a.mean(axis=0), b.mean(axis=0)
    u, s, v = np.linalg.svd((a - mean_a).T @ (b - mean_b))
    sign = np.array([1, 1, np.sign(np.linalg.det(u @ v))])
    linear = (u * sign) @ v * (s @ sign / ((a - mean_a) ** 2).sum())
    return np.vstack([linear, mean_b - mean_a @ linear])


def by_pyfm(source: Mesh, target: Mesh) -> tuple[IntArray, str, float | str]:
    """The steps and weights of pyFM's README."""
    with tempfile.TemporaryDirectory() as name:
        files = [Path(name) / "source.off", Path(name) / "target.off"]
        for file, mesh in zip(files, (source, target), strict=True):
            write_mesh(mesh, file)
        cost(job("pyfm", "match", *files, Path(name) / "map.npy"))
        return np.load(Path(name) / "map.npy"), "", ""


METHODS = {"esd": by_esd, "icp": by_icp, "nearest": by_nearest, "pyfm": by_pyfm}
TITLES = {
    "esd": "`esd.match`",
    "icp": "affine ICP, nearest vertex",
    "nearest": "nearest embedding",
    "pyfm": "pyFM, WKS",
}


# --- measuring ---


@dataclass(frozen=True, slots=True, eq=False)
class Ruler:
    """What errors on a target are measured by."""

    graph: EdgeGraph
    vertex_index: IntArray  # of the graph, of each vertex of the file; -1 where there is none
    diameter: float
    root: float  # √area
    diagonal: float  # of the bounding box


@lru_cache(maxsize=64)
def ruler(shape: Shape) -> Ruler:
    """On the surface with its seams joined, all of its pieces kept, and no hole filled."""
    repaired = repair(shape.mesh, all_pieces=True)
    mesh = repaired.shape
    graph = geodesic_graph(mesh)
    return Ruler(
        graph,
        repaired.vertex_index,
        geodesic_diameter(mesh, graph=graph),
        surface_area(mesh) ** 0.5,
        float(np.linalg.norm(np.ptp(mesh.vertices, axis=0))),
    )


def known_points(source: Shape, target: Shape, count: int) -> IntArray:
    """Some of the points that both shapes have."""
    known = np.flatnonzero((source.index >= 0) & (target.index >= 0))
    return np.random.default_rng(0).permutation(known)[:count]


def errors_along(target: Shape, image: IntArray, known: IntArray) -> FloatArray:
    """Geodesic distances of vertices of the target, -1 for none, from its known points."""
    scale = ruler(target)
    place = np.append(scale.vertex_index, -1)  # of no vertex: none
    (along,) = geodesic_errors(scale.graph, place[image], (place[target.index[known]],))
    return np.minimum(along, scale.diameter)  # another component: infinitely far


def measured(name: str, source: Shape, target: Shape, method: str) -> Row:
    row = {"set": name, "source": source.name, "target": target.name, "method": method}
    start = time.perf_counter()
    try:
        index, verdict, expected = METHODS[method](source.mesh, target.mesh)
    except (InputError, RuntimeError) as failure:
        return Row(**row, failure=" ".join(str(failure).split())[:200])
    row |= {"seconds": time.perf_counter() - start, "verdict": verdict, "expected": expected}
    row["unmatched"] = float((index < 0).mean())
    scale = ruler(target)
    if not len(source.index):
        return Row(
            **row,
            error=100 * distance_when_aligned(source.mesh, target.mesh, index) / scale.diagonal,
        )
    known = known_points(source, target, POINTS)
    image = index[source.index[known]]
    far = (
        np.linalg.norm(target.mesh.vertices[image] - target.points[known], axis=1) / scale.diagonal
    )
    far = far[image >= 0]
    along = errors_along(target, image, known)
    return Row(
        **row,
        error=100 * far.mean(),
        median=100 * float(np.median(far)),
        geodesic=100 * np.nanmean(along) / scale.root,
        right=float((along <= 0.05 * scale.diameter).mean()),
    )


def distance_when_aligned(source: Mesh, target: Mesh, index: IntArray) -> float:
    rows, known = homogeneous(source.vertices), index >= 0
    map_ = np.linalg.lstsq(rows[known], target.vertices[index[known]], rcond=None)[0]
    moved = rows @ map_
    there = KDTree(target.vertices).query(moved)[0].mean()
    return float(there + KDTree(moved).query(target.vertices)[0].mean()) / 2


def read_rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def write_rows(path: Path, rows: Iterator[dict[str, object]], mode: str) -> None:
    with path.open(mode, newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, [field.name for field in fields(Row)])
        if mode == "w":
            writer.writeheader()
        writer.writerows(rows)


def summary(rows: list[dict[str, str]]) -> None:
    """Errors a set and method, how often esd is as good as the best other, and its verdicts."""
    rows = [row for row in rows if row["error"]]
    errors = {(r["set"], r["source"], r["target"], r["method"]): float(r["error"]) for r in rows}
    sets = [name for name in SETS if any(row["set"] == name for row in rows)]
    columns = ("set", "method", "pairs", "mean", "median", "worst", "geodesic × 100", "right", "s")
    table(*columns, "esd ≤ 1.05 × best other")
    for name in sets:
        pairs = {key[:3] for key in errors if key[0] == name}
        for method, title in TITLES.items():
            some = [r for r in rows if (r["set"], r["method"]) == (name, method)]
            if not some:
                continue
            own = np.array([float(r["error"]) for r in some])
            cells = [f"{value:.2f}" for value in (own.mean(), np.median(own), own.max())]
            for key, form in (("geodesic", ".2f"), ("right", ".1%"), ("seconds", ".1f")):
                values = [float(r[key]) for r in some if r[key]]
                cells.append(format(np.mean(values), form) if values else "")
            row(name, title, len(some), *cells, _as_good(errors, pairs) if method == "esd" else "")
    print()
    table("set", "verdict", "maps", "expected", "right", "least", "most")
    for name in [*sets, "all"]:
        said = [
            r
            for r in rows
            if r["verdict"] and r["right"] and r["method"] == "esd" and name in (r["set"], "all")
        ]
        for verdict, count in Counter(r["verdict"] for r in said).most_common():
            some = [r for r in said if r["verdict"] == verdict]
            right = [float(r["right"]) for r in some]
            expected = np.mean([float(r["expected"]) for r in some])
            shares = (expected, np.mean(right), min(right), max(right))
            row(name, verdict, count, *(f"{share:.2f}" for share in shares))


def _as_good(errors: dict[tuple[str, ...], float], pairs: set[tuple[str, ...]]) -> str:
    good = []
    for pair in pairs:
        others = [errors[(*pair, m)] for m in METHODS if m != "esd" and (*pair, m) in errors]
        if others and (*pair, "esd") in errors:
            good.append(errors[(*pair, "esd")] <= 1.05 * min(others))
    return f"{np.mean(good):.0%} of {len(good)}" if good else ""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("--output", "-o", type=Path, required=True, help="CSV file to extend")
    parser.add_argument("--sets", nargs="+", choices=SETS, default=list(SETS))
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=["esd", "icp", "nearest"])
    parser.add_argument("--again", nargs="+", choices=METHODS, default=[], help="measure anew")
    parser.add_argument("--pairs", type=int, help="so many pairs of each set, drawn by the seed")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only-table", action="store_true", help="measure nothing")
    options = parser.parse_args()
    old = read_rows(options.output) if options.output.exists() else []
    kept = (r for r in old if r["method"] not in options.again or r["set"] not in options.sets)
    write_rows(options.output, kept, "w")
    for name in [] if options.only_table else options.sets:
        shapes = [rotated(shape) for shape in SETS[name](options.data / name)]
        for source, target in pairs_of(shapes, options.pairs, options.seed):
            pair = (name, source.name, target.name)
            done = {
                r["method"]
                for r in read_rows(options.output)
                if (r["set"], r["source"], r["target"]) == pair
            }
            for method in options.methods:
                if method not in done:
                    found = measured(*(name, source, target), method)
                    values = {field.name: getattr(found, field.name) for field in fields(Row)}
                    write_rows(options.output, iter([values]), "a")
    summary(read_rows(options.output))


if __name__ == "__main__":
    main()
