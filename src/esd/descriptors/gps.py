"""Global point signature."""

from __future__ import annotations

import numpy as np

from esd.common import FloatArray, InputError
from esd.spectral.spectrum import Spectrum


def gps(spectrum: Spectrum, *, count: int = 25) -> FloatArray:
    """Global point signature, (n, count): φᵢ / √λᵢ for the first non-zero eigenvalues.

    Free of units; unchanged by scaling the shape. The sign of each eigenvector, and the basis
    within a repeated eigenvalue, are arbitrary for each mesh, and so are those of the columns:
    signatures of two meshes compare only up to them. Nothing here hides that.

    Raises
    ------
    InputError
        If the spectrum has fewer non-zero eigenvalues than `count`.

    References
    ----------
    Rustamov 2007, *Laplace-Beltrami eigenfunctions for deformation invariant shape
    representation*; equation 1 of the paper.
    """
    values, vectors = spectrum.nonzero()
    if not 1 <= count <= len(values):
        raise InputError(
            f"GPS of {count} components needs as many non-zero eigenvalues; "
            f"the spectrum has {len(values)}."
        )
    return vectors[:, :count] / np.sqrt(values[:count])
