"""What a user of geomfum would write, after its how-to; run by its own environment.

python geomfum.py match SOURCE TARGET MAP.npy
"""

from __future__ import annotations

import sys

# this file has the name of the package, and its folder must not hide it
sys.path.pop(0)

import numpy as np
from geomfum import functional_map as factors
from geomfum.convert import P2pFromFmConverter
from geomfum.descriptor.pipeline import ArangeSubsampler, DescriptorPipeline, L2InnerNormalizer
from geomfum.descriptor.spectral import WaveKernelSignature
from geomfum.refine import ZoomOut
from geomfum.shape import TriangleMesh
from scipy.optimize import minimize

EIGENPAIRS = 300


def match(source: str, target: str, output: str) -> None:
    a, b = shapes = [TriangleMesh.from_file(path) for path in (target, source)]
    pipeline = DescriptorPipeline(
        [
            WaveKernelSignature.from_registry(n_domain=100),
            ArangeSubsampler(subsample_step=2),
            L2InnerNormalizer(),
        ]
    )
    described = []
    for shape in shapes:
        shape.laplacian.find_spectrum(spectrum_size=EIGENPAIRS, set_as_basis=True)
        described.append(pipeline.apply(shape))
        shape.basis.use_k = 30
    here, there = described
    commuting = factors.OperatorCommutativityEnforcing
    energy = factors.FactorSum(
        [
            factors.SpectralDescriptorPreservation(a.basis.project(here), b.basis.project(there)),
            factors.LBCommutativityEnforcing.from_bases(a.basis, b.basis, weight=1e-1),
            commuting.from_multiplication(a.basis, here, b.basis, there),
            commuting.from_orientation(a, here, b, there),
        ]
    )
    first = np.zeros((30, 30))
    first[0, 0] = np.sign(a.basis.vecs[:, 0].sum() * b.basis.vecs[:, 0].sum())
    # its own wrapper of this function needs geomstats, which no longer imports
    found = minimize(
        lambda x: float(energy(x.reshape(30, 30))),
        first.ravel(),
        jac=lambda x: energy.gradient(x.reshape(30, 30)).ravel(),
        method="L-BFGS-B",
    )
    functional = ZoomOut(nit=27, step=10)(found.x.reshape(30, 30), a.basis, b.basis)
    np.save(output, P2pFromFmConverter()(functional, a.basis, b.basis))


if __name__ == "__main__":
    match(*sys.argv[2:])
