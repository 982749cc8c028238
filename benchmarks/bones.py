"""Rigged characters of a pack, matched: whether vertices go to the bone that moves them.

    python benchmarks/bones.py PACK bones.csv
    python benchmarks/bones.py PACK bones.csv --pairs 20 --include 'T*'

PACK is a folder of rigged glTF files whose bones share their names. Each is turned at random and
matched as `esd match` does, without options. Of the vertices whose bone both rigs have, the share
is measured that goes to a vertex of this bone, of this or one next to it, and of the same bone of
the other side; the same for affine ICP with nearest vertices. Each pair is a row of the CSV file;
pairs that it has are not measured again.
"""

from __future__ import annotations

import argparse
import csv
import sys
from itertools import permutations
from pathlib import Path

import numpy as np
from measure import ROOT, row, rows_in, table
from scipy.spatial.transform import Rotation

import esd
from esd.common import InputError, IntArray
from esd.mesh.mesh import Mesh
from real import by_icp

sys.path.insert(0, str(ROOT / "tools"))
from make_animals import Rig, read_rig

COLUMNS = ("source", "target", "method", "same", "next", "mirrored", "verdict", "expected")


def other_side(name: str) -> str:
    """The name of the bone on the other side; itself if there is none."""
    for left, right in ((".L", ".R"), ("_L", "_R"), ("Left", "Right"), ("L_", "R_")):
        if left in name:
            return name.replace(left, right)
        if right in name:
            return name.replace(right, left)
    return name


def shares(source: Rig, target: Rig, index: IntArray) -> tuple[float, float, float]:
    """Of the vertices: to the same bone, to it or one next to it, to that of the other side."""
    here = [source.names[bone] for bone in source.weights.argmax(axis=1)]
    bones = target.weights.argmax(axis=1)
    near: dict[str, set[str]] = {name: {name} for name in target.names}
    for bone, parent in enumerate(target.parents):
        if parent >= 0:
            near[target.names[bone]].add(target.names[parent])
            near[target.names[parent]].add(target.names[bone])
    known = np.array([name in near for name in here])
    there = [target.names[bone] for bone in bones[index]]
    pairs = [(a, b) for a, b, used in zip(here, there, known & (index >= 0), strict=True) if used]
    same = [a == b for a, b in pairs]
    beside = [b in near[a] for a, b in pairs]
    mirrored = [a != b and other_side(a) == b for a, b in pairs]
    count = np.count_nonzero(known)
    return sum(same) / count, sum(beside) / count, sum(mirrored) / count


def turned(rig: Rig, seed: int) -> Mesh:
    turn = Rotation.random(random_state=seed).as_matrix()
    return Mesh(rig.vertices @ turn.T, rig.faces)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("pack", type=Path)
    parser.add_argument("csv", type=Path)
    parser.add_argument("--include", default="*", help="files, without the ending")
    parser.add_argument("--pairs", type=int, help="only some pairs, drawn by the seed")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    try:
        rigs = [read_rig(path) for path in sorted(options.pack.glob(f"{options.include}.glb"))]
    except InputError as error:
        sys.exit(str(error))
    if len(rigs) < 2:
        sys.exit(
            f"'{options.pack}' holds {len(rigs)} rigs that are included; expected two or more."
        )
    meshes = {rig.name: turned(rig, number) for number, rig in enumerate(rigs)}
    pairs = list(permutations(rigs, 2))
    np.random.default_rng(options.seed).shuffle(pairs)
    measured = {(each["source"], each["target"]) for each in rows_in(options.csv, COLUMNS)}
    for source, target in pairs[: options.pairs]:
        if (source.name, target.name) in measured:
            continue
        shapes = meshes[source.name], meshes[target.name]
        found = esd.match(*shapes)
        judged = found.judgement.verdict, found.judgement.expected_accuracy
        with options.csv.open("a", newline="") as file:
            writer = csv.writer(file)
            head = source.name, target.name
            writer.writerow([*head, "esd", *shares(source, target, found.target_index), *judged])
            writer.writerow([*head, "icp", *shares(source, target, by_icp(*shapes)[0]), "", ""])
    rows = [each for each in rows_in(options.csv, COLUMNS) if each["source"] in meshes]
    table("map", "pairs", "verdict", "bone right", "or one next to it", "least", "other side")
    for method in ("esd", "icp"):
        for verdict in ("good", "doubtful", "failed", "mirrored", ""):
            some = [r for r in rows if (r["method"], r["verdict"]) == (method, verdict)]
            if some:
                same, beside, mirrored = (
                    np.array([float(r[key]) for r in some]) for key in ("same", "next", "mirrored")
                )
                values = same.mean(), beside.mean(), beside.min(), mirrored.mean()
                row(method, len(some), verdict, *(f"{value:.0%}" for value in values))


if __name__ == "__main__":
    main()
