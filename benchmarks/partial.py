"""Parts of shapes matched to whole ones, whole ones to parts, and parts to parts.

    python benchmarks/partial.py default FAUST_R 'tr_reg_06*,tr_reg_07*' --shapes 20
    python benchmarks/partial.py default SMAL_R '*' --kinds 'cut of 35 %' --ways part-part

Each of some shapes, spread evenly, is cut (`esd.datasets.parts.PARTS`) and matched with one of
another subject; every shape is rotated at random. Errors are geodesic, over √area of the
whole target, times 100, of what has a counterpart and is matched; 'right' counts what is not
matched as wrong.
Overlap of two parts is from 20 to 80 % of the source; other pairs of parts are left out.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator

import numpy as np
from measure import row, table

from esd.datasets.collection import Collection, Shape
from esd.datasets.open import open_collection
from esd.datasets.parts import PARTS, part_of_shape
from esd.evaluation.protocol import evaluate
from esd.learning.model import load_model
from esd.mesh.geometry import surface_area
from esd.spectral.cache import default_cache

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


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("model")
    parser.add_argument("dataset")
    parser.add_argument("include")
    parser.add_argument("--kinds", nargs="+", choices=PARTS, default=list(PARTS), metavar="KIND")
    parser.add_argument("--ways", nargs="+", choices=WAYS, default=list(WAYS))
    parser.add_argument("--shapes", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    model = load_model(options.model)
    collection = open_collection(options.dataset).including(options.include)
    columns = ("pairs", "mean error", "median", "worst", "matched", "right", "IoU")
    table("parts", "way", *columns, "balanced accuracy", "separation", "verdicts, least right")
    for kind in options.kinds:
        for way in options.ways:
            pairs = list(pairs_of(collection, kind, way, options.shapes, options.seed))
            if not pairs:
                continue
            found, errors = evaluate(model, pairs, rotate=options.seed, cache=default_cache())
            wholes = {shape.name: shape for shape in collection.shapes}
            means, medians = [], []
            for each, (_, target) in zip(errors, pairs, strict=True):
                whole = wholes[target.name.split(",")[0]]  # of which it may be a part
                unit = surface_area(whole.mesh()) ** 0.5
                means.append(100 * np.nanmean(each.errors) / unit)
                medians.append(100 * np.nanmedian(each.errors) / unit)
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
            )


if __name__ == "__main__":
    main()
