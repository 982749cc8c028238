"""From two mesh files to a map: esd, pyFM and geomfum, whole processes.

    python benchmarks/match.py                         # bodies of people held out for testing
    python benchmarks/match.py FAUST_R --pairs tr_reg_060,tr_reg_071 tr_reg_065,tr_reg_073

Each run is a process that reads two files and writes a map. The methods take turns (A B C A B C),
`--rounds` times; means over pairs of the fastest round. Cold: nothing is in the cache. Warm: the
spectra of both meshes are. Ratios are against the first method. The error is the mean geodesic one,
over the square root of the target's area, times 100.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections import defaultdict
from pathlib import Path

import numpy as np
from measure import Cost, add_peers_option, cost, esd_command, job, row, table

from esd.datasets.open import open_collection
from esd.evaluation.errors import geodesic_errors
from esd.matching.correspondence import load_map
from esd.mesh.geodesics import geodesic_graph
from esd.mesh.geometry import surface_area
from esd.mesh.io.meshes import write_mesh

METHODS = {
    "pyfm-300": "pyFM, 300 eigenpairs, ZoomOut to 300",
    "pyfm": "pyFM, as its README: 200 eigenpairs, ZoomOut to 110",
    "geomfum": "geomfum, 300 eigenpairs, ZoomOut to 300",
    "esd-cold": "`esd match`, cold",
    "esd-warm": "`esd match`, warm",
}
PAIRS = ["s10_p00,s11_p03", "s12_p06,s13_p09"]


def command(method: str, files: list[Path], output: Path) -> list[str]:
    if method.startswith("esd"):
        return esd_command("match", *files, "-o", output, "--force")
    peer, _, eigenpairs = method.partition("-")
    return job(peer, "match", *files, output, *filter(None, [eigenpairs]))


def run(method: str, files: list[Path], output: Path, cache: Path) -> Cost:
    if method == "esd-warm":
        cost(command(method, files, output), cache=cache)
    return cost(command(method, files, output), cache=cache if method == "esd-warm" else "off")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("dataset", nargs="?", default="bodies")
    parser.add_argument("--pairs", nargs="+", default=PAIRS, help="SOURCE,TARGET")
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=list(METHODS))
    parser.add_argument("--rounds", type=int, default=2)
    add_peers_option(parser)
    options = parser.parse_args()
    collection = open_collection(options.dataset)
    best: dict[tuple[str, str], Cost] = {}
    errors = defaultdict(dict)
    for pair in options.pairs:
        source, target = (collection[name] for name in pair.split(","))
        mesh, count = target.mesh(), len(source.mesh().vertices)
        graph, there = geodesic_graph(mesh), target.correspondence()
        with tempfile.TemporaryDirectory() as name:
            files = [Path(name) / "source.off", Path(name) / "target.off"]
            for file, shape in zip(files, (source, target), strict=True):
                write_mesh(shape.mesh(), file)
            for _ in range(options.rounds):
                for method in options.methods:
                    output = Path(name) / f"{method}.npy"
                    try:
                        found = run(method, files, output, Path(name) / "cache")
                    except RuntimeError as error:
                        print(f"{method}: {error}", file=sys.stderr)
                        continue
                    if (pair, method) not in best or found.cpu < best[pair, method].cpu:
                        best[pair, method] = found
                    index = load_map(
                        output, source_count=count, target_count=len(mesh.vertices)
                    ).target_index
                    (error,) = geodesic_errors(graph, index[source.correspondence()], (there,))
                    errors[method][pair] = 100 * error.mean() / np.sqrt(surface_area(mesh))

    def mean(method: str, what: str) -> float:
        return float(np.mean([getattr(best[pair, method], what) for pair in errors[method]]))

    table("", "pairs", "wall s", "CPU s", "× wall", "× CPU", "peak MB", "mean error")
    first = options.methods[0]
    for method in filter(errors.__contains__, options.methods):
        wall, cpu, memory = (mean(method, what) for what in ("wall", "cpu", "memory"))
        row(
            METHODS[method],
            len(errors[method]),
            f"{wall:.1f}",
            f"{cpu:.1f}",
            *(f"{mean(first, what) / mean(method, what):.1f}" for what in ("wall", "cpu")),
            f"{memory:.0f}",
            f"{np.mean(list(errors[method].values())):.2f}",
        )


if __name__ == "__main__":
    main()
