"""Learning without correspondences, measured on shapes that were not trained on.

    python benchmarks/unsupervised.py SMAL_R runs.csv --train 24 --test 8
    python benchmarks/unsupervised.py SMAL_R runs.csv --train 24 --validate 4 --set updates=3
    python benchmarks/unsupervised.py SMAL_R runs.csv --train 24 --validate 4 --no-first-maps

The first shapes of a registered data set by name are trained on, as `esd train` does on a folder
without `corres/`; ordered pairs of the last ones, drawn by a fixed seed and each shape rotated at
random, are matched, by nearest embeddings and as `esd match` does. `--validate N` leaves every Nth
of the training shapes out instead and tests on those: this is what settings are chosen by. `--set`
changes fields of `esd.learning.unsupervised.Teaching`. Errors are geodesic, over √area of the
target, times 100. Each run is a row of the CSV file.
"""

from __future__ import annotations

import argparse
import csv
import resource
from dataclasses import replace
from functools import partial
from itertools import permutations
from pathlib import Path

import numpy as np
from measure import row, table

from esd.datasets.collection import Collection, Shape
from esd.datasets.open import open_collection
from esd.evaluation.protocol import evaluate
from esd.learning.model import load_model, save_model
from esd.learning.presets import preset
from esd.learning.unsupervised import Teaching, train_unsupervised
from esd.matching.first_maps import first_maps
from esd.matching.match import DEFAULT_MODEL
from esd.parallel import Workers
from esd.spectral.cache import default_cache

FIGURES = (
    *("nearest", "nearest_median", "nearest_worst", "refined", "refined_median", "refined_worst"),
    *("accuracy", "cpu_minutes"),
)


def unregistered(collection: Collection) -> Collection:
    """The same shapes, of which no two have a template in common."""
    shapes = tuple(replace(each, template=f"only {each.name}") for each in collection.shapes)
    return replace(collection, name="unregistered", shapes=shapes)


def cpu_seconds() -> float:
    uses = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(use.ru_utime + use.ru_stime for use in uses)


def split(shapes: tuple[Shape, ...], options: argparse.Namespace) -> tuple[list[Shape], ...]:
    """Shapes to train on and to test on."""
    train = list(shapes[: options.train])
    if options.validate:
        held = train[2 :: options.validate]
        return [each for each in train if each not in held], held
    return train, list(shapes[-options.test :])


def value(text: str) -> int | float:
    return float(text) if "." in text or "e" in text else int(text)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("dataset")
    parser.add_argument("csv", type=Path)
    parser.add_argument("--train", type=int, required=True, help="number of shapes, the first")
    parser.add_argument("--test", type=int, default=8, help="number of shapes, the last")
    parser.add_argument("--validate", type=int, default=0, help="every so many of the first")
    parser.add_argument("--pairs", type=int, default=16)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--set", nargs="*", default=[], metavar="FIELD=VALUE")
    parser.add_argument("--no-first-maps", action="store_true")
    parser.add_argument(
        "--start",
        metavar="MODEL",
        help="to start from, instead of first maps; by default the default model is tried in these",
    )
    parser.add_argument("--no-start", action="store_true", help="try no model")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--save", type=Path, help="folder for the model")
    options = parser.parse_args()
    collection = open_collection(options.dataset)
    train, test = split(collection.shapes, options)
    changes = dict(each.split("=") for each in options.set)
    teaching = replace(Teaching(), **{key: value(text) for key, text in changes.items()})
    training, cache, workers = preset("oriented"), default_cache(), Workers(options.workers)
    shapes = unregistered(replace(collection, shapes=tuple(train)))
    before = cpu_seconds()
    maps = partial(
        first_maps,
        collection=shapes,
        recipe=training.recipe,
        start=None if options.no_start else load_model(DEFAULT_MODEL),
        seed=options.seed,
        workers=workers,
        cache=cache,
    )
    model = train_unsupervised(
        shapes,
        training,
        teaching=teaching,
        seed=options.seed,
        start=None if options.start is None else load_model(options.start),
        first_maps=None if options.no_first_maps else maps,
        workers=workers,
        cache=cache,
    )
    minutes = (cpu_seconds() - before) / 60
    if options.save:
        save_model(model, options.save)
    pairs = list(permutations(test, 2))
    np.random.default_rng(0).shuffle(pairs)
    figures: list[float] = []
    accuracy = 0.0
    for refine in (False, True):
        summary, found = evaluate(
            model,
            pairs[: options.pairs],
            refine=refine,
            rotate=0,
            workers=workers,
            cache=cache,
        )
        errors = np.array([100 * np.nanmean(each.errors) / each.square_root_area for each in found])
        figures += [errors.mean(), float(np.median(errors)), errors.max()]
        accuracy = summary.accuracy_5pct_diameter
    values = [f"{each:.3f}" for each in (*figures, accuracy, minutes)]
    ways = ["no first maps"] * options.no_first_maps + ["no start"] * options.no_start
    ways += [] if model.card["start"] is None else [f"from {model.card['start']}"]
    what = " ".join([*options.set, *ways])
    held = f"every {options.validate}th" if options.validate else f"last {options.test}"
    head = (Path(options.dataset).name, held, what, options.seed)
    is_new = not options.csv.exists()
    with options.csv.open("a", newline="") as file:
        writer = csv.writer(file)
        if is_new:
            writer.writerow(("data", "tested", "settings", "seed", *FIGURES))
        writer.writerow((*head, *values))
    table("data", "tested", "settings", "seed", *FIGURES)
    row(*head, *values)


if __name__ == "__main__":
    main()
