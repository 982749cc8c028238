"""Landmark errors on skulls that were not trained on, with no, some or all landmarks for training.

    python benchmarks/skulls.py SKULLS work --train 20 --pairs 12
    python benchmarks/skulls.py SKULLS work --train 20 --pairs 12 --cases none third all --icp

SKULLS has the folders `shapes` and `landmarks`. The first shapes by name are trained on, by
`esd train` without correspondences, with the landmarks of no, of every third, or of all of them;
ordered pairs of the others, drawn by the seed, each shape rotated at random, are matched. Errors
are distances of the matches of the landmarks from the landmarks of the target, in the unit of the
files and in per cent of the diagonal of the target's bounding box. `--icp` measures affine ICP with
nearest vertices beside, and `--default` the model of people.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
from measure import row, table

import esd
from esd.common import IntArray
from real import SETS, Shape, by_icp, pairs_of, rotated

CASES = {"none": 0, "third": 3, "all": 1}  # of which shapes landmarks are given: each so many


def trained(skulls: Path, work: Path, case: str, count: int, seed: int) -> Path:
    """The model of a case, trained if it is not there."""
    model = work / f"model-{case}-{seed}"
    if model.exists():
        return model
    folder = work / case
    shutil.rmtree(folder, ignore_errors=True)
    (folder / "shapes").mkdir(parents=True)
    (folder / "landmarks").mkdir()
    for number, file in enumerate(sorted((skulls / "shapes").glob("*.ply"))[:count]):
        (folder / "shapes" / file.name).symlink_to(file.resolve())
        if CASES[case] and number % CASES[case] == 0:
            landmarks = skulls / "landmarks" / f"{file.stem}.csv"
            (folder / "landmarks" / landmarks.name).symlink_to(landmarks.resolve())
    command = [sys.executable, "-m", "esd", "train", folder, "-o", model, "--seed", seed]
    subprocess.run(list(map(str, command)), check=True)
    return model


def errors(source: Shape, target: Shape, index: IntArray) -> tuple[float, float]:
    """Mean error in the unit of the files, and in per cent of the diagonal."""
    image = index[source.index]
    away = np.linalg.norm(target.mesh.vertices[image] - target.points, axis=1)[image >= 0]
    diagonal = np.linalg.norm(np.ptp(target.mesh.vertices, axis=0))
    return float(away.mean()), float(100 * away.mean() / diagonal)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("skulls", type=Path)
    parser.add_argument("work", type=Path, help="folder for models")
    parser.add_argument("--train", type=int, default=20, help="number of shapes to train on")
    parser.add_argument("--pairs", type=int, default=12)
    parser.add_argument("--cases", nargs="*", choices=CASES, default=list(CASES))
    parser.add_argument("--icp", action="store_true")
    parser.add_argument("--default", action="store_true")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    models = {
        f"trained, landmarks of {case}": str(
            trained(options.skulls, options.work, case, options.train, options.seed)
        )
        for case in options.cases
    }
    if options.default:
        models["model of people"] = "default"
    shapes = [rotated(each) for each in SETS["skulls"](options.skulls)[options.train :]]
    pairs = pairs_of(shapes, options.pairs, options.seed)
    table("map", "pairs", "mean error, mm", "mean, %", "median, %", "worst pair, %")
    methods = {
        name: lambda s, t, model=model: esd.match(s, t, model=model).target_index
        for name, model in models.items()
    }
    if options.icp:
        methods["affine ICP, nearest vertex"] = lambda s, t: by_icp(s, t)[0]
    for name, method in methods.items():
        found = np.array([errors(s, t, method(s.mesh, t.mesh)) for s, t in pairs])
        share = found[:, 1]
        figures = (found[:, 0].mean(), share.mean(), np.median(share), share.max())
        row(name, len(pairs), *(f"{each:.2f}" for each in figures))


if __name__ == "__main__":
    main()
