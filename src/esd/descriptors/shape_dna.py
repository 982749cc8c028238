"""Shape DNA: a descriptor of the whole shape."""

from __future__ import annotations

from esd.common import FloatArray, InputError
from esd.spectral.spectrum import Spectrum


def shape_dna(spectrum: Spectrum, *, count: int = 50) -> FloatArray:
    """The smallest non-zero eigenvalues, (count,), times the surface area: free of units.

    Raises
    ------
    InputError
        If the spectrum has fewer.

    References
    ----------
    Reuter, Wolter, Peinecke 2006, *Laplace-Beltrami spectra as 'Shape-DNA' of surfaces and solids*.
    """
    values, _ = spectrum.nonzero()
    if not 1 <= count <= len(values):
        raise InputError(
            f"Shape DNA of {count} numbers needs as many non-zero eigenvalues; "
            f"the spectrum has {len(values)}."
        )
    return values[:count] * spectrum.area
