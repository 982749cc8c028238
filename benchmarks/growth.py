"""Time, memory and accuracy as meshes become dense: full maps, maps by coarse copies, pyFM.

    python benchmarks/growth.py                                     # 5k to 80k vertices
    python benchmarks/growth.py --subdivide 4 --methods esd         # 1.3 million

Two bodies, each face cut in four again and again; the truth is known at the first vertices. Each
run is a process of its own, from two files to a map, with an empty cache. The error is the mean
over 500 vertices of the geodesic one on the bodies as they were, over the square root of the area,
times 100; an image is taken for the first vertex nearest to it, so that 0.3 or so is rounding.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

import numpy as np
from match import PAIRS
from measure import add_peers_option, cost, esd_command, job, row, table
from scipy.spatial import cKDTree

from esd.datasets.open import open_collection
from esd.evaluation.errors import geodesic_errors
from esd.mesh.geodesics import geodesic_graph
from esd.mesh.geometry import surface_area
from esd.mesh.io.meshes import write_mesh
from esd.mesh.shapes import subdivide

METHODS = {
    "pyfm": "pyFM, 300 eigenpairs, ZoomOut to 300",
    "esd": "`esd match`",
    "full": "`esd match --full`",
}
LIMITS = {"pyfm": 30_000, "esd": 3_000_000, "full": 100_000}


def command(method: str, files: list[Path], output: Path) -> list[str]:
    if method == "pyfm":
        return job("pyfm", "match", *files, output, 300)
    more = ["--full"] if method == "full" else []
    return esd_command("match", *files, "-o", output, "--force", *more)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("dataset", nargs="?", default="bodies")
    parser.add_argument("--pair", default=PAIRS[0], help="SOURCE,TARGET")
    parser.add_argument("--subdivide", type=int, nargs="+", default=[0, 1, 2])
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=list(METHODS))
    add_peers_option(parser)
    options = parser.parse_args()
    collection = open_collection(options.dataset)
    shapes = [collection[name] for name in options.pair.split(",")]
    base = shapes[1].mesh()
    graph, scale = geodesic_graph(base), np.sqrt(surface_area(base)) / 100
    here, there = (shape.correspondence() for shape in shapes)
    known = np.flatnonzero((here >= 0) & (there >= 0))
    known = np.random.default_rng(0).choice(known, 500, replace=False)
    table("n", "", "wall s", "CPU s", "peak MB", "mean error")
    with tempfile.TemporaryDirectory() as name:
        files = [Path(name) / "source.off", Path(name) / "target.off"]
        for times in options.subdivide:
            for file, shape in zip(files, shapes, strict=True):
                mesh = shape.mesh()
                for _ in range(times):
                    mesh = subdivide(mesh)
                write_mesh(mesh, file)
            count = len(mesh.vertices)
            for method in options.methods:
                if count > LIMITS[method]:
                    continue
                output = Path(name) / "map.npy"
                try:
                    done = cost(command(method, files, output))
                except RuntimeError as error:
                    print(f"{method}: {error}", file=sys.stderr)
                    continue
                image = mesh.vertices[np.load(output)[here[known]]]
                snapped = cKDTree(base.vertices).query(image)[1]
                (error,) = geodesic_errors(graph, snapped, (there[known],))
                row(count, METHODS[method], *done.cells(), f"{error.mean() / scale:.2f}")


if __name__ == "__main__":
    main()
