"""`esd spectrum`."""

from __future__ import annotations

from enum import Enum
from pathlib import Path
from typing import Annotated, Any

import typer

from esd.cli.doctor import tell_findings
from esd.cli.options import ForceOption
from esd.cli.output import about, destination, tell
from esd.cli.progress import progress


class Operator(str, Enum):
    """Names of the Laplacians."""

    cotangent = "cotangent"
    robust = "robust"


def spectrum(
    mesh: Annotated[Path, typer.Argument(metavar="MESH", help="A mesh file.")],
    output: Annotated[
        Path | None,
        typer.Option(
            "--output", "-o", metavar="FILE", help="Ends in .npz; by default MESH-spectrum.npz."
        ),
    ] = None,
    k: Annotated[int, typer.Option("-k", min=1, help="Number of eigenpairs.")] = 300,
    laplacian: Annotated[
        Operator, typer.Option(help="Cotangent, or robust for meshes with slivers.")
    ] = Operator.cotangent,
    coarse: Annotated[
        int | None,
        typer.Option(
            metavar="N",
            min=300,
            help="For dense meshes: about the eigenpairs, by those of a copy of about N vertices.",
            show_default=False,
        ),
    ] = None,
    force: ForceOption = False,
) -> None:
    """Write the smallest Laplace-Beltrami eigenpairs of MESH, for unit surface area.

    MESH may be broken, or points alone: see esd doctor. All of its pieces take part; vertices that
    were left out have zeros.
    """
    from esd.mesh.repair.repair import repair
    from esd.spectral.cache import default_cache
    from esd.spectral.coarse import coarse_spectrum
    from esd.spectral.spectrum import check_spectrum_path, save_spectrum
    from esd.spectral.spectrum import spectrum as compute

    path = check_spectrum_path(output or Path(f"{mesh.stem}-spectrum.npz"))
    destination(path, force=force, inputs=[mesh])
    options: dict[str, Any] = {"kind": laplacian.value, "cache": default_cache()}
    with about(mesh), progress("computing"):
        repaired = repair(mesh, all_pieces=True)
        if coarse is None:
            eigenpairs = compute(repaired.shape, k, **options)
        else:
            eigenpairs = coarse_spectrum(repaired.shape, k, vertex_count=coarse, **options)
    eigenpairs = eigenpairs.carried(repaired.vertex_index)
    tell_findings(mesh, repaired)
    save_spectrum(eigenpairs, path)
    values = eigenpairs.eigenvalues
    tell(f"{len(values)} eigenvalues from {values[0]:g} to {values[-1]:g}; {path}")
