"""What each part of the preset `oriented` gives: trained without it, one at a time.

    python benchmarks/ablation.py FAUST_R 'tr_reg_0[0-3]*' 'tr_reg_0[45]*' --pairs 8
    python benchmarks/ablation.py SMAL_R '0*,4*,[A-Z]*,c*,dog*,fox*,gr*,hippo5' \
        'hippo_*,lion*,muybridge_0[1-7]*' --pairs 18

Trains on the first shapes, tests on pairs of different subjects of the second. Mean geodesic errors
over the square root of the area, times 100: by nearest neighbour; the same where the edges of the
target follow its curvature; and refined. Needs torch.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import replace

from esd.datasets.collection import Shape
from esd.datasets.open import open_collection
from esd.datasets.remeshing import remeshed_shape
from esd.descriptors.recipe import Descriptor
from esd.evaluation.protocol import evaluate
from esd.learning.presets import PRESETS, Training
from esd.learning.train import train
from esd.spectral.cache import default_cache

PRESET = PRESETS["oriented"]


def without(is_off: Callable[[Descriptor], bool]) -> Training:
    kept = tuple(part for part in PRESET.recipe.descriptors if not is_off(part))
    return replace(PRESET, recipe=replace(PRESET.recipe, descriptors=kept))


def is_of(kind: str) -> Callable[[Descriptor], bool]:
    return lambda part: kind in (part.kind, part.options.get("of"))


TRAININGS = {
    "the preset": PRESET,
    "without odd products (chirality)": without(lambda part: part.kind == "chirality"),
    "without even products (alignment)": without(lambda part: part.kind == "alignment"),
    "without HKS and its products": without(is_of("hks")),
    "without WKS and its products": without(is_of("wks")),
    "products alone": without(lambda part: part.kind in ("hks", "wks")),
    "the paper's loss": replace(PRESET, loss="contrastive"),
    "the paper's network, 78-32-15": replace(PRESET, hidden=(78, 32), outputs=15),
    "nothing dropped": replace(PRESET, dropout=0.0),
    "no remeshed copies": replace(PRESET, remeshings=0),
    "no limit": replace(PRESET, limit=None),
}


def other_triangles(shape: Shape) -> Shape:
    count = len(shape.mesh().vertices)
    return remeshed_shape(
        shape, vertex_count=count, style="adaptive", seed=1, name=f"{shape.name}, remeshed"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("dataset")
    parser.add_argument("train")
    parser.add_argument("test")
    parser.add_argument("--pairs", type=int, default=10)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", nargs="*", choices=list(TRAININGS), default=list(TRAININGS))
    options = parser.parse_args()
    collection, cache = open_collection(options.dataset), default_cache()
    every = collection.including(options.test).pairs()
    pairs = every[:: max(1, len(every) // options.pairs)][: options.pairs]
    remeshed = {target.name: other_triangles(target) for _, target in pairs}
    print("| | nearest neighbour | other triangles | refined | training, s |")
    print("|---|--:|--:|--:|--:|")
    for name in options.only:
        start = time.perf_counter()
        model = train(
            collection.including(options.train), TRAININGS[name], seed=options.seed, cache=cache
        )
        cells = [f"{time.perf_counter() - start:.0f}"]
        tests = {
            "nearest": (pairs, False),
            "other": ([(source, remeshed[target.name]) for source, target in pairs], False),
            "refined": (pairs, True),
        }
        found = [
            evaluate(model, chosen, refine=refine, cache=cache)[0].mean_geodesic_error_x100
            for chosen, refine in tests.values()
        ]
        cells = [*(f"{error:.2f}" for error in found), *cells]
        print(f"| {name} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
