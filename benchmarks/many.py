"""Tens of thousands of small shapes: what precomputing them, and training on them, takes.

    python benchmarks/many.py                      # 40,000 shapes, half an hour on two cores
    python benchmarks/many.py --shapes 2000

Each shape is a blend of two bodies on one triangulation of about 450 vertices, in a file of its
own. Training is measured from the store of all and from a store of 80; steps per second are those
between two trainings that differ in their number of steps.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from measure import cost, row, table
from scipy.spatial import KDTree

from esd.datasets.open import open_collection
from esd.mesh.io.meshes import write_mesh
from esd.mesh.mesh import Mesh
from esd.mesh.remesh.remesh import remesh

VERTICES = 360
FEW = 80


def write_shapes(folder: Path, count: int) -> None:
    bodies = open_collection("bodies").shapes
    first, points = bodies[0].mesh(), bodies[0].correspondence()
    coarse = remesh(first, VERTICES, seed=0).mesh
    places = KDTree(first.vertices[points]).query(coarse.vertices)[1]
    poses = [body.mesh().vertices[body.correspondence()[places]] for body in bodies]
    generator = np.random.default_rng(0)
    for number in range(count):
        a, b = generator.choice(len(poses), 2, replace=False)
        share = generator.random()
        blend = share * poses[a] + (1 - share) * poses[b]
        write_mesh(Mesh(blend, coarse.faces), folder / f"shape{number:05d}.off")


def esd(*arguments: object):
    return cost([sys.executable, "-m", "esd", *map(str, arguments)])


def steps_per_second(store: Path, folder: Path, steps: int) -> tuple[float, float]:
    """Of wall time, and the megabytes that training takes."""
    found = []
    for times in (1, 3):
        options = ("--preset", "paper-hks", "--steps", times * steps, "--force")
        found.append(esd("train", store, "-o", folder / "model", *options))
    return 2 * steps / (found[1].wall - found[0].wall), found[1].memory


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--shapes", type=int, default=40_000)
    parser.add_argument("--steps", type=int, default=4000)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder, store, small = (Path(name) / part for part in ("shapes", "all.h5", "few.h5"))
        folder.mkdir()
        write_shapes(folder, options.shapes)
        preset = ("--preset", "paper-hks")
        start = time.perf_counter()
        open_collection(folder)
        opening = time.perf_counter() - start
        found = esd("precompute", folder, "-o", store, *preset, "--json")
        again = esd("precompute", folder, "-o", store, *preset, "--json")
        assert json.loads(again.output)["unchanged"] == options.shapes
        few = f"shape000[0-{FEW // 10 - 1}]?"
        esd("precompute", folder, "-o", small, *preset, "--include", few)
        table(f"{options.shapes:,} shapes", "wall s", "CPU s", "peak MB")
        row("open the folder", f"{opening:.1f}", "", "")
        row("precompute", *found.cells())
        row("again, nothing changed", *again.cells())
        print(f"\nstore: {store.stat().st_size / 2**20:.0f} MB\n")
        table("training", "steps / s", "peak MB")
        for label, file in ((f"{FEW} shapes", small), (f"{options.shapes:,} shapes", store)):
            speed, memory = steps_per_second(file, Path(name), options.steps)
            row(label, f"{speed:.0f}", f"{memory:.0f}")


if __name__ == "__main__":
    main()
