"""Refinement of one first map: esd's ways and pyFM's ZoomOut.

    python benchmarks/refinement.py                       # bodies of people held out for testing
    python benchmarks/refinement.py FAUST_R --pairs tr_reg_060,tr_reg_071

The first map is the nearest neighbour of the default model. Seconds of CPU in one process, without
reading and writing; the error is the mean geodesic one, over √area, times 100.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np
from match import PAIRS
from measure import add_peers_option, cost, job, row, table

from esd.datasets.open import open_collection
from esd.evaluation.errors import geodesic_errors
from esd.learning.model import load_model
from esd.matching.local_refine import levels, local_zoomout
from esd.matching.refine import zoomout
from esd.mesh.geodesics import geodesic_graph
from esd.mesh.geometry import surface_area
from esd.nearest import nearest
from esd.spectral.cache import default_cache
from esd.spectral.spectrum import spectrum

STEPS = tuple(range(30, 301, 10))
WAYS = [
    "none",
    "pyFM, ZoomOut, 30 to 300 by 10",
    "`esd`, the same steps",
    "`esd`, six sizes",
    "`esd`, six sizes, embedding beside",
    "`esd`, the same on samples and nearby (default)",
]


def refined(way, spectra, meshes, rows, first, folder):
    """The map refined in one of the `WAYS`, and the seconds that took."""
    if way == "none":
        return first, 0.0
    if way.startswith("pyFM"):
        files = [folder / name for name in ("source.npz", "target.npz", "first.npy", "map.npy")]
        for file, spectrum in zip(files, spectra, strict=False):
            np.savez(file, eigenvectors=spectrum.eigenvectors, mass=spectrum.mass)
        np.save(files[2], first)
        done = cost(job("pyfm", "refine", *files))
        return np.load(files[3]), float(done.output)
    if way.endswith("(default)"):
        start, count = time.process_time(), max(map(len, rows))
        both = [
            levels(spectrum, mesh.vertices, count=count)
            for spectrum, mesh in zip(spectra, meshes, strict=True)
        ]
        index, _ = local_zoomout(*both, rows, embeddings=rows)
        return index, time.process_time() - start
    how = {"sizes": STEPS} if "same steps" in way else {}
    if "beside" in way:
        how["embeddings"] = rows
    start = time.process_time()
    return zoomout(*spectra, first, **how), time.process_time() - start


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("dataset", nargs="?", default="bodies")
    parser.add_argument("--pairs", nargs="+", default=PAIRS, help="SOURCE,TARGET")
    parser.add_argument("--rounds", type=int, default=2)
    add_peers_option(parser)
    options = parser.parse_args()
    collection, model = open_collection(options.dataset), load_model("default")
    seconds: dict[str, list[float]] = {}
    errors: dict[str, list[float]] = {}
    for pair in options.pairs:
        shapes = [collection[name] for name in pair.split(",")]
        meshes = [shape.mesh() for shape in shapes]
        spectra = [spectrum(mesh, cache=default_cache()) for mesh in meshes]
        rows = tuple(model.embed_mesh(mesh, cache=default_cache()) for mesh in meshes)
        first, _ = nearest(*rows)
        graph, scale = geodesic_graph(meshes[1]), np.sqrt(surface_area(meshes[1])) / 100
        here, there = (shape.correspondence() for shape in shapes)
        with tempfile.TemporaryDirectory() as name:
            for way in WAYS * options.rounds:
                index, spent = refined(way, spectra, meshes, rows, first, Path(name))
                (error,) = geodesic_errors(graph, index[here], (there,))
                seconds.setdefault(way, []).append(spent)
                errors.setdefault(way, []).append(error.mean() / scale)
    table("refinement", "pairs", "CPU s", "mean error")
    for way, spent in seconds.items():
        row(way, len(options.pairs), f"{np.median(spent):.2f}", f"{np.mean(errors[way]):.2f}")


if __name__ == "__main__":
    main()
