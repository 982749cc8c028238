"""What a user of pyFM would write; run by its own environment.

python pyfm.py match SOURCE TARGET MAP.npy [EIGENPAIRS]
python pyfm.py descriptors SPECTRUM.npz OUTPUT.npz
python pyfm.py refine SOURCE.npz TARGET.npz FIRST.npy MAP.npy
"""

from __future__ import annotations

import sys
import time

import numpy as np


def match(source: str, target: str, output: str, eigenpairs: str | None = None) -> None:
    """The steps and weights of pyFM's README, or the same with more eigenpairs, all refined by."""
    from pyFM.functional import FunctionalMapping
    from pyFM.mesh import TriMesh

    # its maps lead from the second mesh to the first
    meshes = [TriMesh.load(path, area_normalize=True, center=True) for path in (target, source)]
    model = FunctionalMapping(*meshes)
    more = {"k_process": int(eigenpairs), "k_descr": int(eigenpairs)} if eigenpairs else {}
    model.preprocess(descr_type="WKS", subsample_step=2, **more)
    model.fit(K=30, w_descr=1e0, w_lap=1e-1, w_dcomm=1e0, w_orient=1e0)
    if eigenpairs:
        refined = model.zoomout_refine(nit=(int(eigenpairs) - 30) // 10, step=10)
    else:
        refined = model.zoomout_refine(nit=16, step=5)
    np.save(output, model.get_p2p(refined))


def descriptors(spectrum: str, output: str) -> None:
    from pyFM.signatures import HKS, WKS

    with np.load(spectrum) as file:
        values, vectors = file["eigenvalues"], file["eigenvectors"]
        times, energies, width = file["times"], file["energies"], float(file["width"])
    start = time.process_time()
    heat = HKS(values, vectors, times, scaled=False)
    middle = time.process_time()
    wave = WKS(values[1:], vectors[:, 1:], energies, width, scaled=True)
    np.savez(output, hks=heat, wks=wave, cpu=[middle - start, time.process_time() - middle])


def refine(source: str, target: str, first: str, output: str) -> None:
    from pyFM.refine.zoomout import zoomout_refine
    from pyFM.spectral import FM_to_p2p, p2p_to_FM
    from scipy import sparse

    shapes = [np.load(path) for path in (target, source)]
    vectors = [shape["eigenvectors"] for shape in shapes]
    mass = sparse.diags(shapes[1]["mass"])
    index = np.load(first)
    start = time.process_time()
    functional = p2p_to_FM(index, vectors[0][:, :30], vectors[1][:, :30], A2=mass)
    functional = zoomout_refine(functional, *vectors, nit=27, step=10, A2=mass)
    index = FM_to_p2p(functional, *vectors)
    print(time.process_time() - start)
    np.save(output, index)


if __name__ == "__main__":
    {"match": match, "descriptors": descriptors, "refine": refine}[sys.argv[1]](*sys.argv[2:])
