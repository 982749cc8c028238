"""`esd spectrum`."""

from __future__ import annotations

from enum import Enum
from pathlib import Path
from typing import Annotated

import typer

from esd.cli.doctor import tell_findings


class Operator(str, Enum):
    """Names of the Laplacians."""

    cotangent = "cotangent"
    robust = "robust"


def spectrum(
    mesh: Annotated[Path, typer.Argument(help="A mesh file.")],
    output: Annotated[Path, typer.Option("--output", "-o", metavar="FILE", help="Ends in .npz.")],
    k: Annotated[int, typer.Option("-k", help="Number of eigenpairs.")] = 300,
    laplacian: Annotated[
        Operator, typer.Option(help="Cotangent, or robust for meshes with slivers.")
    ] = Operator.cotangent,
) -> None:
    """Write the smallest Laplace-Beltrami eigenpairs of MESH, for unit surface area.

    MESH may be broken, or points alone: see esd doctor. All of its pieces take part; vertices that
    were left out have zeros.
    """
    from esd.mesh.doctor import repair
    from esd.spectral.cache import default_cache
    from esd.spectral.spectrum import check_spectrum_path, save_spectrum
    from esd.spectral.spectrum import spectrum as compute

    check_spectrum_path(output)
    shape = repair(mesh, all_pieces=True)
    pairs = compute(shape.shape, k, kind=laplacian.value, cache=default_cache())
    pairs = pairs.carried(shape.vertex_index)
    tell_findings(mesh, shape)
    save_spectrum(pairs, output)
    values = pairs.eigenvalues
    typer.echo(f"{len(values)} eigenvalues from {values[0]:g} to {values[-1]:g}; {output}")
