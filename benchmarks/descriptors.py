"""HKS and WKS of one spectrum: esd, pyFM and LaPy.

    python benchmarks/descriptors.py

A hundred times and energies each, of 300 eigenpairs of a bumpy torus, the same for all. Seconds of
CPU, the least of the rounds; difference is the largest to esd's, relative.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np
from eigensolver import bumpy_torus
from measure import add_peers_option, cost, job, row, table

from esd.descriptors.hks import heat_times, hks
from esd.descriptors.wks import wave_energies, wks
from esd.spectral.spectrum import spectrum


def ours(eigenpairs):
    start = time.process_time()
    heat = hks(eigenpairs)
    middle = time.process_time()
    wave = wks(eigenpairs)
    return {"hks": heat, "wks": wave, "cpu": [middle - start, time.process_time() - middle]}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sizes", type=int, nargs="+", default=[5000, 20000])
    parser.add_argument("--rounds", type=int, default=3)
    add_peers_option(parser)
    options = parser.parse_args()
    table("n", "", "HKS, s", "WKS, s", "difference of HKS", "of WKS")
    for size in options.sizes:
        eigenpairs = spectrum(bumpy_torus(size))
        energies, width = wave_energies(eigenpairs)
        with tempfile.TemporaryDirectory() as name:
            given, made = Path(name) / "spectrum.npz", Path(name) / "made.npz"
            np.savez(
                given,
                eigenvalues=eigenpairs.eigenvalues,
                eigenvectors=eigenpairs.eigenvectors,
                times=heat_times(eigenpairs),
                energies=energies,
                width=width,
            )
            found, seconds = {}, {}
            for _ in range(options.rounds):
                for peer in ("esd", "pyfm", "lapy"):
                    if peer == "esd":
                        found[peer] = ours(eigenpairs)
                    else:
                        cost(job(peer, "descriptors", given, made))
                        with np.load(made) as file:
                            found[peer] = dict(file)
                    seconds.setdefault(peer, []).append(found[peer]["cpu"])
        for peer, values in found.items():
            least = np.min(seconds[peer], axis=0)
            gaps = [
                float(np.max(np.abs(values[kind] / found["esd"][kind] - 1)))
                for kind in ("hks", "wks")
                if kind in values
            ]
            times = [f"{x:.3f}" for x in least] + ["–"] * (2 - len(least))
            row(size, peer, *times, *(f"{x:.0e}" for x in gaps), *["–"] * (2 - len(gaps)))


if __name__ == "__main__":
    main()
