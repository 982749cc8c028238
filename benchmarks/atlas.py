"""Atlases of unregistered shapes, beside those of true registrations.

    python benchmarks/atlas.py bodies --poses 0,3,6 -o atlas-bodies
    python benchmarks/atlas.py folder ../shared/data/smal_r -o atlas-smal
    python benchmarks/atlas.py folder ../shared/data/skulls -o atlas-skulls --landmarks 12

`bodies`: the ten training subjects, each shape remeshed on its own and its correspondences not
used, beside the same shapes with the triangles of their template. The first body with those is the
template. `folder`: meshes with their `.vts` or landmarks, which only measure the result; with
`--landmarks N`, N of the landmarks guide the maps, and the others measure. The output folder is
kept, and an interrupted run resumes. Times are of the processor, for all processes together.
"""

from __future__ import annotations

import argparse
import os
import resource
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from scipy.linalg import subspace_angles
from scipy.spatial import KDTree

import esd
from esd.datasets.bodies import TRAINING_SUBJECTS, bodies
from esd.datasets.collection import Collection, Shape
from esd.datasets.open import open_collection
from esd.mesh.io.landmarks import Landmarks
from esd.parallel import Workers
from esd.population.atlas import Atlas
from esd.population.files import save_atlas


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", choices=["bodies", "folder"])
    parser.add_argument("folder", type=Path, nargs="?")
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--poses", default="0")
    parser.add_argument(
        "--seeds", default="0", help="of the triangles, which one body may have twice"
    )
    parser.add_argument("--include")
    parser.add_argument("--template", default="auto")
    parser.add_argument("--vertices", type=int, default=10_000, help="of an automatic template")
    parser.add_argument("--model", default="default")
    parser.add_argument("--landmarks", type=int, default=0)
    parser.add_argument("--keep-failed", action="store_true")
    parser.add_argument("--workers", type=int)
    arguments = parser.parse_args()
    if arguments.data == "bodies":
        of_bodies(arguments)
    else:
        of_folder(arguments)


def of_bodies(arguments: argparse.Namespace) -> None:
    names = [f"{s}_p{int(p):02d}" for s in TRAINING_SUBJECTS for p in arguments.poses.split(",")]
    pieces = [(seed, bodies(seed=int(seed)).named(names)) for seed in arguments.seeds.split(",")]
    remeshed = Collection(
        "bodies", tuple(replace(s, name=f"{s.name}_{seed}") for seed, of in pieces for s in of)
    )
    known = bodies(remeshed=False).named(names)
    registered = Collection(
        "bodies",
        tuple(replace(s, name=f"{s.name}_{seed}") for seed, _ in pieces for s in known),
    )
    template = registered.shapes[0].mesh()
    found = measured(remeshed, arguments, template=template)
    truth = esd.atlas(replace(registered, shapes=registered.named(found.names)), registered=True)
    extent = np.ptp(truth.vertices, axis=1).max(axis=1)
    gap = np.linalg.norm(found.vertices - truth.vertices, axis=2)
    print(f"vertex error, mean of shapes: {100 * np.mean(np.nanmean(gap, axis=1) / extent):.3f} %")
    print("modes | variance explained: atlas | truth | ratio of variances | largest angle, degrees")
    for count in (1, 2, 3, 5, 9):
        if count > len(found.modes):
            break
        angle = np.degrees(subspace_angles(*(weighted(each, count) for each in (found, truth))))
        ratio = found.variances[:count].sum() / truth.variances[:count].sum()
        row = found.model.explained()[count - 1], truth.model.explained()[count - 1], ratio
        print(count, *(f"{value:.3f}" for value in row), f"{angle.max():.1f}", sep=" | ")
    for name, each in (("atlas", found), ("truth", truth)):
        print(f"{name}: {separation(each)}")


def weighted(atlas: Atlas, count: int) -> np.ndarray:
    """The first modes as columns, orthonormal."""
    seen = np.isfinite(atlas.mean).all(axis=1)
    modes = atlas.modes[:count, seen] * np.sqrt(atlas.model.mass[seen])[:, None]
    return modes.reshape(count, -1).T


def separation(atlas: Atlas) -> str:
    """Whether the shape with the nearest scores is of the same subject, and how much nearer.

    Also the share of the variance of the scores that lies between subjects, and what that is by
    chance, for labels given at random.
    """
    subject = np.array(atlas.subjects)
    gap = np.linalg.norm(atlas.scores[:, None] - atlas.scores, axis=2)
    np.fill_diagonal(gap, np.inf)
    same = subject[:, None] == subject
    right = same[np.arange(len(gap)), gap.argmin(axis=1)].mean()
    own, other = (np.where(which, gap, np.inf).min(axis=1) for which in (same, ~same))
    text = f"nearest by scores is of the same subject: {right:.0%}"
    if np.isfinite(own).all():
        text += f"; median distance {np.median(own):.4f}, to another subject {np.median(other):.4f}"
        scores, names = atlas.scores - atlas.scores.mean(axis=0), np.unique(subject)
        between = sum(
            (subject == name).sum() * (scores[subject == name].mean(axis=0) ** 2).sum()
            for name in names
        )
        share, chance = between / (scores**2).sum(), (len(names) - 1) / (len(scores) - 1)
        text += f"; variance between subjects {share:.2%} (chance {chance:.0%})"
    return text


def of_folder(arguments: argparse.Namespace) -> None:
    collection = open_collection(arguments.folder)
    if arguments.include:
        collection = collection.including(arguments.include)
    guiding = collection
    if arguments.landmarks:
        shapes = [
            replace(s, landmarks=partial(first, s, arguments.landmarks)) for s in collection.shapes
        ]
        guiding = replace(collection, shapes=tuple(shapes))
    else:
        guiding = replace(
            collection, shapes=tuple(replace(s, landmarks=None) for s in collection.shapes)
        )
    found = measured(guiding, arguments, template=arguments.template)
    for name, reason in found.left_out.items():
        print(f"left out: {name}: {reason}")
    share = ", ".join(f"{value:.2f}" for value in found.model.explained()[:5])
    print(f"variance explained by 1, 2, … modes: {share}")
    shapes = {shape.name: shape for shape in collection.shapes}
    if found.template not in shapes:
        return
    template = shapes[found.template]
    errors = [
        error
        for name, vertices in zip(found.names, found.vertices, strict=True)
        if name != found.template
        for error in [
            point_error(arguments.output, template, shapes[name], vertices, arguments.landmarks)
        ]
        if error is not None
    ]
    if errors:
        print(
            f"error of the known points: mean of shapes {100 * np.mean(errors):.2f} % of the "
            f"bounding diagonal, worst {100 * np.max(errors):.2f} %"
        )


def first(shape: Shape, count: int) -> Landmarks:
    """Some of the landmarks of a shape, spread over their list."""
    known = shape.landmarks()
    order = sorted(known.names)
    chosen = {order[i] for i in np.linspace(0, len(order) - 1, count).round().astype(int)}
    keep = [i for i, name in enumerate(known.names) if name in chosen]
    return Landmarks(tuple(known.names[i] for i in keep), known.vertices[keep])


def point_error(
    folder: Path, template: Shape, shape: Shape, vertices: np.ndarray, guiding: int
) -> float | None:
    """Mean distance of known points, carried by the registered template, from where they are."""
    pairs = known_points(template, shape, guiding)
    if pairs is None:
        return None
    here, there = pairs
    base = esd.read_mesh(folder / "template.ply").vertices
    near = KDTree(base).query(here)[1]
    found = vertices[near]
    present = np.isfinite(found).all(axis=1)
    gap = np.linalg.norm(found - there, axis=1)[present]
    return float(gap.mean() / np.linalg.norm(np.ptp(shape.mesh().vertices, axis=0)))


def known_points(
    template: Shape, shape: Shape, guiding: int
) -> tuple[np.ndarray, np.ndarray] | None:
    """Positions that correspond: by `.vts`, or landmarks that did not guide the maps."""
    meshes = template.mesh().vertices, shape.mesh().vertices
    if template.template == shape.template and not template.template.startswith("only"):
        index = template.correspondence(), shape.correspondence()
        both = (index[0] >= 0) & (index[1] >= 0)
        return meshes[0][index[0][both]], meshes[1][index[1][both]]
    if template.landmarks is None or shape.landmarks is None:
        return None
    used = set(first(template, guiding).names) if guiding else set()
    marks = [
        dict(zip(m.names, m.vertices, strict=True))
        for m in (template.landmarks(), shape.landmarks())
    ]
    names = [n for n in marks[0] if n not in used and marks[0][n] >= 0 and marks[1].get(n, -1) >= 0]
    return tuple(mesh[[mark[n] for n in names]] for mesh, mark in zip(meshes, marks, strict=True))


def measured(collection: Collection, arguments: argparse.Namespace, *, template: object) -> Atlas:
    """The atlas, what it cost, and its folder written."""
    arguments.output.mkdir(parents=True, exist_ok=True)
    before = seconds()
    found = esd.atlas(
        collection,
        template=template,
        model=arguments.model,
        folder=arguments.output,
        keep_failed=arguments.keep_failed,
        vertex_count=arguments.vertices,
        workers=Workers(arguments.workers),
    )
    spent = seconds() - before
    save_atlas(found, arguments.output)
    new = sum(each.is_new for each in found.shapes)
    memory = max(
        resource.getrusage(who).ru_maxrss
        for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    )
    print(f"{len(found.shapes)} shapes, {new} of them computed, template '{found.template}'")
    print(
        f"{spent:.0f} s of the processor, {spent / max(new, 1):.1f} s a shape; at most "
        f"{memory / 1e6:.2f} GB in a process"
    )
    distance = [each.distance for each in found.shapes if not each.failure]
    inverted = sum(each.inverted for each in found.shapes)
    print(
        f"distance to the surface: mean {100 * np.mean(distance):.3f} % of the extent; "
        f"{inverted} faces inverted"
    )
    return found


def seconds() -> float:
    """Seconds of the processor, of this process and its children."""
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


if __name__ == "__main__":
    main()
