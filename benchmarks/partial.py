"""Parts of shapes matched to whole ones, whole ones to parts, and parts to parts.

    python benchmarks/partial.py default FAUST_R 'tr_reg_06*,tr_reg_07*' --shapes 20
    python benchmarks/partial.py default SMAL_R '*' --kinds 'cut of 35 %' --ways part-part

Each of some shapes, spread evenly, is cut (`esd.datasets.parts.PARTS`) and matched with one of
another subject; every shape is rotated at random. Errors are geodesic, over √area of the
whole target, times 100, of what has a counterpart and is matched; 'right' counts what is not
matched as wrong.
Overlap of two parts is from 20 to 80 % of the source; other pairs of parts are left out.
With `--beside`, mean errors of affine ICP and of nearest embeddings of the default model follow.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np
from measure import row, table

from esd.common import IntArray
from esd.datasets.collection import Collection, Shape
from esd.datasets.open import open_collection
from esd.datasets.parts import PARTS, part_of_shape
from esd.evaluation.errors import Truth, errors_on_target
from esd.evaluation.protocol import PairErrors, evaluate, randomly_rotated
from esd.learning.model import load_model
from esd.mesh.geometry import surface_area
from esd.spectral.cache import default_cache
from real import by_icp, by_nearest

WAYS = ("part-whole", "whole-part", "part-part")


def pairs_of(
    collection: Collection, kind: str, way: str, count: int, seed: int
) -> Iterator[tuple[Shape, Shape]]:
    """Shapes spread evenly, each with one of another subject, drawn by the seed."""
    generator = np.random.default_rng(seed)
    shapes = collection.shapes[:: max(1, len(collection.shapes) // count)][:count]
    for number, source in enumerate(shapes):
        others = [
            shape
            for shape in collection.shapes
            if shape.template == source.template and shape.subject != source.subject
        ]
        target = others[generator.integers(len(others))]
        if way != "whole-part":
            source = part_of_shape(source, kind, seed=seed + number)
        if way != "part-whole":
            target = part_of_shape(target, kind, seed=seed + 1000 + number)
        if way != "part-part" or 0.2 <= overlap(source, target) <= 0.8:
            yield source, target


def overlap(source: Shape, target: Shape) -> float:
    """Share of the source's points that the target has."""
    return float((target.correspondence()[source.correspondence() >= 0] >= 0).mean())


def with_points(shape: Shape, count: int) -> Shape:
    """The shape with some points of its template, the same of all shapes."""
    return replace(shape, correspondence=partial(some_points, shape, count), symmetric=None)


def some_points(shape: Shape, count: int) -> IntArray:
    index = shape.correspondence()
    return index[np.sort(np.random.default_rng(0).permutation(len(index))[:count])]


def errors_beside(source: Shape, target: Shape, seed: int) -> list[float]:
    """Mean errors of affine ICP and of nearest embeddings of the default model, in lengths."""
    source, target = (randomly_rotated(each, seed=seed) for each in (source, target))
    meshes = source.mesh(), target.mesh()
    points = source.correspondence(), target.correspondence()
    both = (points[0] >= 0) & (points[1] >= 0)
    maps = [by(*meshes)[0][points[0][both]] for by in (by_icp, by_nearest)]
    truth = Truth(meshes[1], points[1][both], None)
    return [float(np.nanmean(errors)) for errors in errors_on_target(truth, np.stack(maps)).direct]


def line(each: PairErrors, unit: float) -> str:
    """What is known of one pair."""
    values = (
        *(100 * f(each.errors) / unit for f in (np.nanmean, np.nanmedian)),
        each.right().mean(),
        each.overlap_iou(),
        each.confidence_separation() or np.nan,
        each.expected_accuracy or np.nan,
    )
    names = ("error", "median", "right", "IoU", "separation", "expected")
    said = ", ".join(f"{name} {value:.3g}" for name, value in zip(names, values, strict=True))
    return f"{each.source} → {each.target}: {said}, {each.verdict}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("model")
    parser.add_argument("dataset")
    parser.add_argument("include")
    parser.add_argument("--kinds", nargs="+", choices=PARTS, default=list(PARTS), metavar="KIND")
    parser.add_argument("--ways", nargs="+", choices=WAYS, default=list(WAYS))
    parser.add_argument("--shapes", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--points", type=int, default=10_000_000, help="of the template, at most")
    parser.add_argument("--candidates", nargs="+", help="as those of esd match")
    parser.add_argument("--beside", action="store_true")
    options = parser.parse_args()
    model = load_model(options.model)
    collection = open_collection(options.dataset).including(options.include)
    columns = ("pairs", "mean error", "median", "worst", "matched", "right", "IoU")
    others = ("affine ICP", "nearest embedding") if options.beside else ()
    table(
        "parts",
        "way",
        *columns,
        "balanced accuracy",
        "separation",
        "verdicts, least right",
        *others,
    )
    for kind in options.kinds:
        for way in options.ways:
            pairs = list(pairs_of(collection, kind, way, options.shapes, options.seed))
            if not pairs:
                continue
            shapes = {each.name: each for pair in pairs for each in pair}
            thinned = {name: with_points(each, options.points) for name, each in shapes.items()}
            pairs = [(thinned[source.name], thinned[target.name]) for source, target in pairs]
            found, errors = evaluate(
                model,
                pairs,
                candidates=options.candidates,
                rotate=options.seed,
                cache=default_cache(),
            )
            wholes = {shape.name: shape for shape in collection.shapes}
            means, medians, beside = [], [], []
            for each, (source, target) in zip(errors, pairs, strict=True):
                whole = wholes[target.name.split(",")[0]]  # of which it may be a part
                unit = surface_area(whole.mesh()) ** 0.5
                means.append(100 * np.nanmean(each.errors) / unit)
                medians.append(100 * np.nanmedian(each.errors) / unit)
                print(line(each, unit), file=sys.stderr, flush=True)
                if options.beside:
                    more = errors_beside(source, target, options.seed)
                    beside.append([100 * value / unit for value in more])
            overlaps = (
                found.overlap_iou,
                found.overlap_balanced_accuracy,
                found.confidence_separation,
            )
            row(
                *(kind, way, found.pairs),
                *(f"{value:.2f}" for value in (np.mean(means), np.mean(medians), max(means))),
                f"{found.matched:.1%}",
                f"{found.accuracy_5pct_diameter:.1%}",
                *("" if value is None else f"{value:.2f}" for value in overlaps),
                ", ".join(f"{v} {c.maps} ({c.least_right:.0%})" for v, c in found.verdicts.items()),
                *(f"{value:.1f}" for value in (np.mean(beside, axis=0) if beside else ())),
            )


if __name__ == "__main__":
    main()
