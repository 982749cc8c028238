"""Many small pairs: `esd batch` beside the sum of the matches that it computes.

    python benchmarks/batch.py                       # 200 pairs of 40 shapes of about 450 vertices
    python benchmarks/batch.py --pairs 50 --model default

The sum is of a process that has read and described all shapes before, and of each pair computes the
map and writes it. Seconds of CPU; both run with one process, and nothing is cached.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from many import write_shapes
from measure import cost, row, table

from esd.learning.model import load_model
from esd.matching.correspondence import save_map
from esd.matching.match import match_features, prepared, working_features
from esd.mesh.io.meshes import read_arrays


def own(function, *arguments, **options):
    """What a function returns, and the seconds of CPU that it took."""
    start = time.process_time()
    return function(*arguments, **options), time.process_time() - start


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--pairs", type=int, default=200)
    parser.add_argument("--shapes", type=int, default=40)
    parser.add_argument("--model", default="wks")
    options = parser.parse_args()
    os.environ["ESD_CACHE"] = "off"
    model = load_model(options.model)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_shapes(folder, options.shapes)
        files = sorted(folder.glob("*.off"))
        generator = np.random.default_rng(0)
        pairs = set()
        while len(pairs) < options.pairs:
            pairs.add(tuple(generator.choice(len(files), 2, replace=False).tolist()))
        lines = [f"{files[a].name},{files[b].name}" for a, b in sorted(pairs)]
        (folder / "pairs.csv").write_text("\n".join(["source,target", *lines, ""]))
        command = ["-m", "esd", "batch", folder / "pairs.csv", "-o", folder / "maps"]
        command += ["--model", options.model, "--workers", "1", "--quiet"]
        batch = cost([sys.executable, *map(str, command)])

        def described():
            shapes = [prepared(read_arrays(file)) for file in files]
            return [working_features(shape, model=model) for shape in shapes]

        def matched():
            for a, b in sorted(pairs):
                found = match_features(features[a], features[b], model=model)
                save_map(found, folder / "sum.csv")

        features, describing = own(described)
        _, matching = own(matched)
    table("", f"{options.model}, {options.pairs} pairs", "CPU s", "a pair, ms")
    whole = describing + matching
    for label, seconds in (
        ("describing shapes", describing),
        ("matching and writing", matching),
        ("sum", whole),
        ("`esd batch`", batch.cpu),
    ):
        row(label, "", f"{seconds:.2f}", f"{1000 * seconds / options.pairs:.1f}")
    print(f"\n`esd batch` takes {batch.cpu / whole:.2f} times the sum; {batch.memory:.0f} MB.")


if __name__ == "__main__":
    main()
