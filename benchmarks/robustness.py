"""How maps change when a shape does: in what should not matter, and by damage.

    python benchmarks/robustness.py default FAUST_R 'tr_reg_06*,tr_reg_07*' -o rows.csv

Each shape is matched to a shape of another subject unaltered, and altered in many ways, which
`match` repairs unasked; the error is measured on the other shape, which is not
altered, at some random points. It resumes when rerun: rows in the file are not measured again. The
ratio is that of the mean error to that of the same shapes unaltered.
Needs fast-simplification, which `pip install '.[dev]'` brings.
"""

from __future__ import annotations

import argparse
import csv
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TypeAlias

import numpy as np
from real_triangles import decimated, with_long_triangles
from scipy.spatial import KDTree

from esd.common import FloatArray, IntArray
from esd.datasets.collection import Collection, Shape
from esd.datasets.open import open_collection
from esd.datasets.parts import Perturbed
from esd.datasets.perturb import (
    edge_flips,
    geometric_noise,
    holes,
    plane_cut,
    short_circuits,
)
from esd.evaluation.errors import geodesic_errors
from esd.learning.model import Model, load_model
from esd.matching.features import shape_features
from esd.matching.match import match_features, prepared, working_features
from esd.mesh.geodesics import geodesic_diameter, geodesic_graph
from esd.mesh.geometry import edge_lengths, surface_area
from esd.mesh.mesh import Mesh
from esd.mesh.remesh.remesh import remesh
from esd.mesh.repair.repair import repair
from esd.mesh.shapes import icosphere, subdivide
from esd.spectral.cache import default_cache

Altered: TypeAlias = tuple[FloatArray, IntArray, IntArray]
"""Vertices, faces, and the new vertex of each old one, -1 where it is gone."""

Alter: TypeAlias = Callable[[Mesh, np.random.Generator], Altered]

HEADER = (
    *("shape", "target", "alteration", "error", "right", "unmatched"),
    *("severity", "verdict", "expected"),
)
FIRST = "unaltered"
POINTS = 1000


def with_vertices(vertices_of: Callable[[Mesh, np.random.Generator], FloatArray]) -> Alter:
    """Other coordinates."""
    return lambda mesh, rng: (vertices_of(mesh, rng), mesh.faces, np.arange(len(mesh.vertices)))


def with_faces(faces_of: Callable[[Mesh, np.random.Generator], IntArray]) -> Alter:
    """Other faces between the same vertices."""
    return lambda mesh, rng: (mesh.vertices, faces_of(mesh, rng), np.arange(len(mesh.vertices)))


def with_triangles(mesh_of: Callable[[Mesh], Mesh]) -> Alter:
    """Other triangles; old vertices go to the nearest new ones."""

    def alter(mesh: Mesh, rng: np.random.Generator) -> Altered:
        made = mesh_of(mesh)
        return made.vertices, made.faces, KDTree(made.vertices).query(mesh.vertices)[1]

    return alter


def perturbed(disturb: Callable[..., Perturbed], level: float) -> Alter:
    def alter(mesh: Mesh, rng: np.random.Generator) -> Altered:
        made = disturb(mesh, level, seed=int(rng.integers(2**31)))
        return made.mesh.vertices, made.mesh.faces, made.vertex_index

    return alter


def rotated(mesh: Mesh, rng: np.random.Generator) -> FloatArray:
    rotation, _ = np.linalg.qr(rng.standard_normal((3, 3)))
    return mesh.vertices @ (rotation * np.linalg.det(rotation))


def shaken(mesh: Mesh, rng: np.random.Generator) -> FloatArray:
    step = 0.3 * edge_lengths(mesh).mean() / np.sqrt(3)
    return mesh.vertices + step * rng.standard_normal(mesh.vertices.shape)


def shuffled(mesh: Mesh, rng: np.random.Generator) -> Altered:
    order = rng.permutation(len(mesh.vertices))
    place = np.argsort(order)
    return mesh.vertices[order], place[mesh.faces], place


def inverted(share: float) -> Alter:
    """Faces of the opposite orientation."""
    return with_faces(
        lambda mesh, rng: np.where(
            rng.random((len(mesh.faces), 1)) < share, mesh.faces[:, ::-1], mesh.faces
        )
    )


def stretched(mesh: Mesh) -> Mesh:
    """Long triangles: the surface is decimated while it is four times as tall."""
    is_y = np.ptp(mesh.vertices, axis=0).argmax() == 1
    axis = np.array([0.0, 1.0, 0.0] if is_y else [0.0, 0.0, 1.0])
    return with_long_triangles(mesh, 5000, stretch=4.0, axis=axis)


def disconnected(share: float) -> Alter:
    """Faces with vertices of their own, as all have in STL."""

    def alter(mesh: Mesh, rng: np.random.Generator) -> Altered:
        count, faces = len(mesh.vertices), mesh.faces.copy()
        loose = np.flatnonzero(rng.random(len(faces)) < share)
        faces[loose] = count + np.arange(3 * len(loose)).reshape(-1, 3)
        vertices = np.concatenate([mesh.vertices, mesh.vertices[mesh.faces[loose]].reshape(-1, 3)])
        index = np.arange(count)
        index[mesh.faces.ravel()] = faces.ravel()
        return vertices, faces, index

    return alter


def dirty(share: float) -> Alter:
    """Vertices that are not finite, duplicate faces, another component, unreferenced vertices."""

    def alter(mesh: Mesh, rng: np.random.Generator) -> Altered:
        count, ball = len(mesh.vertices), icosphere(2)
        vertices = mesh.vertices.copy()
        vertices[rng.choice(count, int(share * count), replace=False)] = np.nan
        twice = mesh.faces[: int(share * len(mesh.faces))]
        return (
            np.concatenate([vertices, 0.05 * ball.vertices + 3, rng.random((20, 3))]),
            np.concatenate([mesh.faces, twice, ball.faces + count]),
            np.arange(count),
        )

    return alter


def with_slivers(share: float) -> Alter:
    """Some faces split into a degenerate and two other triangles, by a vertex more on an edge."""

    def alter(mesh: Mesh, rng: np.random.Generator) -> Altered:
        count, cut = len(mesh.vertices), rng.random(len(mesh.faces)) < share
        a, b, c = mesh.faces[cut].T
        middle = count + np.arange(len(a))
        vertices = np.concatenate([mesh.vertices, (mesh.vertices[a] + mesh.vertices[b]) / 2])
        pieces = [np.stack([*side, middle], axis=1) for side in ((a, b), (b, c), (c, a))]
        return vertices, np.concatenate([mesh.faces[~cut], *pieces]), np.arange(count)

    return alter


def in_bands(mesh: Mesh, rng: np.random.Generator) -> Altered:
    """Five bands of equal area along the longest side, half a percent of the diagonal apart."""
    size = np.ptp(mesh.vertices, axis=0)
    along = size.argmax()
    middle = mesh.vertices[mesh.faces, along].mean(axis=1)
    band = np.digitize(middle, np.quantile(middle, [0.2, 0.4, 0.6, 0.8]))
    index = np.full(len(mesh.vertices), -1)
    vertices, faces, count = [], [], 0
    for number in range(5):
        used, corners = np.unique(mesh.faces[band == number], return_inverse=True)
        index[used] = count + np.arange(len(used))  # on a seam, that of the upper band
        vertices.append(mesh.vertices[used])
        vertices[-1][:, along] += number * 0.005 * np.linalg.norm(size)
        faces.append(corners.reshape(-1, 3) + count)
        count += len(used)
    return np.concatenate(vertices), np.concatenate(faces), index


def on_the_ground(mesh: Mesh, rng: np.random.Generator) -> Altered:
    """With a square of 40 × 40 vertices at its feet, twice as wide as it is high."""
    size = np.ptp(mesh.vertices, axis=0)
    up, *others = np.argsort(-size)
    x, y = np.meshgrid(*2 * [np.linspace(-1, 1, 40)])
    ground = np.empty((x.size, 3))
    middle = mesh.vertices.mean(axis=0)
    ground[:, up] = mesh.vertices[:, up].min()
    for axis, offset in zip(others, (x, y), strict=True):
        ground[:, axis] = middle[axis] + size[up] * offset.ravel()
    corner = np.add.outer(40 * np.arange(39), np.arange(39)).ravel()[:, None]
    count = len(mesh.vertices)
    halves = (corner + count + np.array(half) for half in ([0, 1, 41], [0, 41, 40]))
    faces = np.concatenate([mesh.faces, *halves])
    return np.concatenate([mesh.vertices, ground]), faces, np.arange(count)


ALTERATIONS: dict[str, Alter] = {
    FIRST: with_vertices(lambda mesh, rng: mesh.vertices),
    "rotated": with_vertices(rotated),
    "scaled by 0.2": with_vertices(lambda mesh, rng: 0.2 * mesh.vertices),
    "scaled by 4": with_vertices(lambda mesh, rng: 4 * mesh.vertices),
    "vertices shuffled": shuffled,
    "noise of 0.3 mean edges": with_vertices(shaken),
    "mirrored": with_vertices(lambda mesh, rng: mesh.vertices * [-1, 1, 1]),
    "inside out": with_faces(lambda mesh, rng: mesh.faces[:, ::-1]),
    "noise along the normals, 0.2 mean edges": perturbed(geometric_noise, 0.2),
    "noise along the normals, 1 mean edge": perturbed(geometric_noise, 1.0),
    "ten holes, 2 % of the area": perturbed(holes, 0.02),
    "ten holes, 20 %": perturbed(holes, 0.2),
    "flipped edges, 5 % of the faces": perturbed(edge_flips, 0.05),
    "flipped edges, 50 %": perturbed(edge_flips, 0.5),
    "short circuits, 0.2 % of the faces": perturbed(short_circuits, 0.002),
    "short circuits, 5 %": perturbed(short_circuits, 0.05),
    "cut by a plane, 5 % of the area": perturbed(plane_cut, 0.05),
    "cut by a plane, 35 %": perturbed(plane_cut, 0.35),
    "disconnected faces, 5 %": disconnected(0.05),
    "disconnected faces, all": disconnected(1.0),
    "inverted faces, 5 %": inverted(0.05),
    "inverted faces, 50 %": inverted(0.5),
    "sliver triangles, at 0.1 % of the faces": with_slivers(0.001),
    "sliver triangles, at 10 %": with_slivers(0.1),
    "dirt, 0.2 %": dirty(0.002),
    "dirt, 3 %": dirty(0.03),
    "five bands, 0.5 % of the diagonal apart": in_bands,
    "on a ground plane": on_the_ground,
    "triangles: even, 5,000 vertices": with_triangles(
        lambda mesh: remesh(mesh, 5000, style="even", seed=0).mesh
    ),
    "triangles: coarse, 2,500": with_triangles(
        lambda mesh: remesh(mesh, 2500, style="even", seed=0).mesh
    ),
    "triangles: fine, 15,000": with_triangles(
        lambda mesh: remesh(mesh, 15_000, style="even", seed=0).mesh
    ),
    "triangles: dense, 20,000 (each in four)": with_triangles(subdivide),
    "triangles: long, 5,000 (library)": with_triangles(stretched),
    "triangles: decimated, 10,000 (each in four, half left)": with_triangles(
        lambda mesh: decimated(subdivide(mesh), 10_000)
    ),
    "triangles: by curvature, 3,000 (library)": with_triangles(lambda mesh: decimated(mesh, 3000)),
}


def neighbours(collection: Collection) -> Iterator[tuple[Shape, Shape]]:
    """Each shape with the first one of the next subject, then with its second one, and so on."""
    subjects = list(collection.subjects)
    groups = [[s for s in collection.shapes if s.subject == subject] for subject in subjects]
    for place, group in enumerate(groups):
        other = groups[(place + 1) % len(groups)]
        for i, shape in enumerate(group):
            yield shape, other[i % len(other)]


def rows(
    model: Model, source: Shape, target: Shape, alterations: list[str]
) -> Iterator[tuple[object, ...]]:
    """A row of `HEADER` for each alteration of the source."""
    whole, there = target.mesh(), target.correspondence()
    graph = geodesic_graph(whole)
    diameter, root = geodesic_diameter(whole, graph=graph), surface_area(whole) ** 0.5
    clean = shape_features(repair(whole), model=model, cache=default_cache())
    points = np.flatnonzero((source.correspondence() >= 0) & (there >= 0))
    points = np.random.default_rng(0).permutation(points)[:POINTS]
    for name in alterations:
        rng = np.random.default_rng(int("".join(filter(str.isdigit, source.name))[-3:]))
        vertices, faces, index = ALTERATIONS[name](source.mesh(), rng)
        repaired = prepared((vertices, faces))
        features = working_features(repaired, model=model)
        found = match_features(features, clean, model=model)
        here = index[source.correspondence()[points]]
        predicted = np.where(here >= 0, found.target_index[here], -1)
        (error,) = geodesic_errors(graph, predicted, (there[points],))
        matched = np.isfinite(error)
        yield (
            source.name,
            target.name,
            name,
            100 * error[matched].mean() / root,
            (error[matched] <= 0.05 * diameter).mean(),
            1 - matched.mean(),
            repaired.diagnosis.severity,
            found.judgement.verdict,
            found.judgement.expected_accuracy,
        )


def table(found: list[dict[str, str]]) -> Iterator[str]:
    yield "| source | shapes | mean error | ratio | within 5 % | unmatched | severity | verdict |"
    yield "|---|--:|--:|--:|--:|--:|---|---|"
    unaltered = {row["shape"]: float(row["error"]) for row in found if row["alteration"] == FIRST}
    for name in ALTERATIONS:
        some = [row for row in found if row["alteration"] == name]
        if not some:
            continue
        error, right, unmatched = (
            np.mean([float(row[key]) for row in some]) for key in ("error", "right", "unmatched")
        )
        ratio = error / np.mean([unaltered[row["shape"]] for row in some])
        said = (
            ", ".join(
                f"{what} {count}" for what, count in Counter(row[key] for row in some).most_common()
            )
            for key in ("severity", "verdict")
        )
        yield (
            f"| {name} | {len(some)} | {error:.2f} | {ratio:.2f} | {right:.1%} | {unmatched:.0%} | "
            f"{' | '.join(said)} |"
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("model")
    parser.add_argument("dataset")
    parser.add_argument("include")
    parser.add_argument("--output", "-o", type=Path, required=True)
    parser.add_argument("--only", nargs="+", default=[""], help="alterations that begin so")
    parser.add_argument("--shapes", type=int, help="so many of them, spread evenly")
    options = parser.parse_args()
    model = load_model(options.model)
    pairs = list(neighbours(open_collection(options.dataset).including(options.include)))
    pairs = pairs[:: max(1, len(pairs) // (options.shapes or len(pairs)))][: options.shapes]
    wanted = [name for name in ALTERATIONS if name.startswith((FIRST, *options.only))]
    if not options.output.exists():
        options.output.write_text(",".join(HEADER) + "\n")
    for source, target in pairs:
        with options.output.open(newline="") as file:
            done = {
                row["alteration"] for row in csv.DictReader(file) if row["shape"] == source.name
            }
        for row in rows(model, source, target, [name for name in wanted if name not in done]):
            with options.output.open("a", newline="") as file:
                csv.writer(file).writerow(row)
    with options.output.open(newline="") as file:
        print("\n".join(table(list(csv.DictReader(file)))))


if __name__ == "__main__":
    main()
