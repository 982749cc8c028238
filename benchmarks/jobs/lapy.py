"""What a user of LaPy would write; run by its own environment.

python lapy.py descriptors SPECTRUM.npz OUTPUT.npz
"""

from __future__ import annotations

import sys
import time

# this file has the name of the package, and its folder must not hide it
sys.path.pop(0)

import numpy as np
from lapy import heat


def descriptors(spectrum: str, output: str) -> None:
    with np.load(spectrum) as file:
        values, vectors, times = file["eigenvalues"], file["eigenvectors"], file["times"]
    everywhere = np.arange(len(vectors))
    start = time.process_time()
    signature = heat.diagonal(times[None], everywhere, vectors, values[:, None], len(values))
    np.savez(output, hks=signature, cpu=[time.process_time() - start])


if __name__ == "__main__":
    descriptors(*sys.argv[2:])
