"""Train the models that ship with the package and write their figures into their cards.

    python tools/make_wide_bodies.py wide
    python tools/make_animals.py CHARACTERS animals
    python tools/bundle_models.py --sets wide bodies animals --transfer FAUST_R 'tr_reg_0[67]*'

A model that is there already is only measured; remove its folder to train it again. `--only`
restricts it to some. The default model, `oriented`, is trained on `--sets`, of which only the
bodies ship: its layers by the preset of its name, and the network beside them by `surface`. Weights
are rounded to 16 bits.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from esd.datasets.collection import Collection
from esd.datasets.open import open_collection
from esd.evaluation.protocol import evaluate
from esd.learning.fit import fit
from esd.learning.model import Model, load_model, save_model, with_diffusion
from esd.learning.presets import preset
from esd.parallel import EVERY_CORE
from esd.spectral.cache import default_cache

MODELS = Path(__file__).parents[1] / "src" / "esd" / "learning" / "models"
DEFAULT = "oriented"
BUNDLED = (DEFAULT, "paper-gps", "paper-hks", "paper-wks", "partial")  # presets
STEPS = {DEFAULT: 8000, "surface": 3000}  # of the two presets that the default model is trained by
HELD_OUT = "s1[0-3]_p0[0369]"  # the subjects held out for testing, in four poses


def default_model(folder: Path, sets: Sequence[str]) -> Model:
    """The default model: each of its training shapes has triangles of its own, so no copies."""
    collections = [open_collection(each) for each in sets]
    shapes = [
        shape
        for each in collections
        for shape in each.excluding_subjects(each.testing_subjects).shapes
    ]
    collection = Collection(", ".join(each.name for each in collections), tuple(shapes))
    layers, network = (
        fit(
            collection,
            replace(preset(name), remeshings=0, steps=steps),
            name=name,
            checkpoint=folder.with_name(f"{name}.checkpoint"),
            workers=EVERY_CORE,
            cache=default_cache(),
            on_progress=print,
        )
        for name, steps in STEPS.items()
    )
    model = with_diffusion(layers, network)
    command = f"python tools/bundle_models.py --sets {' '.join(sets)} --only {DEFAULT}"
    note = f"The network beside the layers: the same shapes, {network.card['steps_done']} steps."
    beside = {key: value for key, value in network.card.items() if key != "shapes"}
    card = {**model.card, "command": command, "note": note, "network": beside}
    return replace(model, card=card)


def figures(model: Model, collection: Collection, *, refine: bool, count: int | None) -> str:
    pairs = collection.pairs()
    pairs = pairs[:: max(1, len(pairs) // (count or len(pairs)))][:count]
    result, _ = evaluate(
        model,
        pairs,
        refine=refine,
        workers=EVERY_CORE,
        cache=default_cache(),
    )
    symmetric = result.symmetric_mean_geodesic_error_x100
    return (
        f"{result.mean_geodesic_error_x100:.2f} mean geodesic error x 100 / √area, "
        + ("" if symmetric is None else f"{symmetric:.2f} symmetry-aware, ")
        + f"{result.accuracy_5pct_diameter:.1%} within 5 % of the diameter ({result.pairs} pairs)"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--transfer", nargs=2, metavar=("FOLDER", "GLOB"), action="append", default=[]
    )
    parser.add_argument("--only", nargs="*", choices=BUNDLED, default=BUNDLED)
    parser.add_argument("--sets", nargs="+", help="what the default model is trained on")
    parser.add_argument("--pairs", type=int, help="measure on so many of each set, spread evenly")
    options = parser.parse_args()
    MODELS.mkdir(exist_ok=True)
    held_out = open_collection("bodies").including(HELD_OUT)
    for name in options.only:
        folder = MODELS / name
        command = f"esd train bodies --preset {name} -o {name} --seed 0"
        made_by = {}  # the card of a model that is there says it, if it was a command
        if name == DEFAULT and not folder.exists():
            if options.sets is None:
                parser.error(f"training '{DEFAULT}' takes --sets")
            save_model(default_model(folder, options.sets), folder)
        elif not folder.exists():
            arguments = [*command.split()[1:-3], str(folder), "--seed", "0"]
            subprocess.run([sys.executable, "-m", "esd", *arguments], check=True)
            made_by = {"command": command}
        model = load_model(folder)
        card = {**model.card, **made_by}
        sets = {"held_out_bodies": held_out}
        for data, pattern in options.transfer:
            other = open_collection(data).including(pattern)
            sets[f"{other.name} {pattern}"] = other
        for title, collection in sets.items():
            card[f"on {title}"] = figures(model, collection, refine=False, count=options.pairs)
            if model.is_oriented:
                card[f"on {title}, refined"] = figures(
                    model, collection, refine=True, count=options.pairs
                )
        save_model(replace(model, card=card), folder, half_precision=True)
        print(name, card, sep="\n")


if __name__ == "__main__":
    main()
