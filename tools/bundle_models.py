"""Train the models that ship with the package and write their figures into their cards.

    python tools/bundle_models.py --transfer FAUST_R 'tr_reg_0[67]*' --transfer TOSCA_R 'david*'

A model that is there already is only measured; remove its folder to train it again. `--only`
restricts it to some.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

from esd.datasets.collection import Collection
from esd.datasets.open import open_collection
from esd.evaluation.protocol import evaluate
from esd.learning.model import Model, load_model, save_model
from esd.parallel import EVERY_CORE
from esd.spectral.cache import default_cache

MODELS = Path(__file__).parents[1] / "src" / "esd" / "learning" / "models"
BUNDLED = ("oriented", "paper-gps", "paper-hks", "paper-wks", "partial")  # presets
HELD_OUT = "s1[0-3]_p0[0369]"  # the subjects held out for testing, in four poses


def figures(model: Model, collection: Collection, *, refine: bool) -> str:
    result, _ = evaluate(
        model,
        collection.pairs(),
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
    options = parser.parse_args()
    MODELS.mkdir(exist_ok=True)
    held_out = open_collection("bodies").including(HELD_OUT)
    for name in options.only:
        folder = MODELS / name
        command = f"esd train bodies --preset {name} -o {name} --seed 0"
        if not folder.exists():
            arguments = [*command.split()[1:-3], str(folder), "--seed", "0"]
            subprocess.run([sys.executable, "-m", "esd", *arguments], check=True)
            made_by = {"command": command}
        else:
            made_by = {}  # its card says it, if it was a command
        model = load_model(folder)
        card = {**model.card, **made_by}
        sets = {"held_out_bodies": held_out}
        for data, pattern in options.transfer:
            other = open_collection(data).including(pattern)
            sets[f"{other.name} {pattern}"] = other
        for title, collection in sets.items():
            card[f"on {title}"] = figures(model, collection, refine=False)
            if model.is_oriented:
                card[f"on {title}, refined"] = figures(model, collection, refine=True)
        save_model(replace(model, card=card), folder)
        print(name, card, sep="\n")


if __name__ == "__main__":
    main()
