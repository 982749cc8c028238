"""Registrations of one body template to the people of FAUST_r, beside fits without the map.

    python benchmarks/registration.py ../shared/data/faust_r --scans 60-79

prints a line for each scan and the means. Lengths are in % of the scan's longest extent. The error
of a vertex is its distance to the true vertex; that of the map, the same of the matched vertex.
'points only' starts from the same rigid alignment and has nearest points instead of the map.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np

import esd
from esd.datasets.folder import read_vts
from esd.mesh.mesh import Mesh
from esd.registration.fit import Fit, fit
from esd.registration.quality import quality


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--template", default="tr_reg_000")
    parser.add_argument("--scans", default="60-79", help="first and last number")
    arguments = parser.parse_args()
    first, last = map(int, arguments.scans.split("-"))
    template = esd.read_mesh(arguments.folder / "shapes" / f"{arguments.template}.off")
    here = read_vts(arguments.folder / "corres" / f"{arguments.template}.vts")
    print("scan | distance | error | of the map | inverted | points only: distance | error | s")
    rows = []
    for number in range(first, last + 1):
        name = f"tr_reg_{number:03d}"
        scan = esd.read_mesh(arguments.folder / "shapes" / f"{name}.off")
        there = read_vts(arguments.folder / "corres" / f"{name}.vts")
        match = esd.match(template, scan, mirror="no")
        start = time.perf_counter()
        found = esd.register(template, scan, correspondence=match)
        seconds = time.perf_counter() - start
        extent = found.quality.extent
        true = scan.vertices[there]
        alone = points_only(template, scan, match.target_index)
        row = [
            found.quality.relative_distance,
            error(found.mesh.vertices[here], true) / extent,
            error(scan.vertices[match.target_index[here]], true) / extent,
            found.quality.inverted / 100,
            quality(template, scan, alone).relative_distance,
            error(alone.vertices[here], true) / extent,
            seconds / 100,
        ]
        rows.append(row)
        print(name, *(f"{100 * value:.3f}" for value in row), sep=" | ", flush=True)
    print("mean", *(f"{100 * value:.3f}" for value in np.mean(rows, axis=0)), sep=" | ")


def error(points: np.ndarray, true: np.ndarray) -> float:
    """Mean distance of corresponding points."""
    return float(np.linalg.norm(points - true, axis=1).mean())


def points_only(template: Mesh, scan: Mesh, target_index: np.ndarray) -> Fit:
    """The template fitted to nearest points alone, from the rigid alignment that the map gives."""
    from scipy.spatial.transform import Rotation

    matched = target_index >= 0
    before, after = template.vertices[matched], scan.vertices[target_index[matched]]
    rotation, _ = Rotation.align_vectors(after - after.mean(axis=0), before - before.mean(axis=0))
    start = rotation.apply(template.vertices - before.mean(axis=0)) + after.mean(axis=0)
    none = np.full(len(start), -1)
    return fit(template, scan, none, np.zeros(len(none)), start=start)


if __name__ == "__main__":
    main()
