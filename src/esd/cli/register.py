"""`esd register`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from esd.cli.options import DeviceOption, ForceOption, JsonOption, ModelOption
from esd.cli.output import about, destination, tell
from esd.cli.progress import progress
from esd.cli.shapes import landmark_pairs

if TYPE_CHECKING:
    from esd.mesh.mesh import Mesh


def register(
    template: Annotated[
        Path, typer.Argument(metavar="TEMPLATE", help="Mesh that is deformed; it needs faces.")
    ],
    scan: Annotated[
        Path, typer.Argument(metavar="SCAN", help="Mesh or point cloud that it is deformed onto.")
    ],
    output: Annotated[
        Path,
        typer.Option(
            "--output", "-o", metavar="OUT", help="The template on the scan, .ply, .obj, .off, …"
        ),
    ],
    map: Annotated[
        Path | None,
        typer.Option(
            "--map", metavar="MAP", help="From TEMPLATE to SCAN; by default it is computed."
        ),
    ] = None,
    landmarks: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="FILE [FILE]",
            help="Landmarks of TEMPLATE and of SCAN, see esd match.",
            show_default=False,
        ),
    ] = None,
    model: ModelOption = "default",
    device: DeviceOption = "cpu",
    as_json: JsonOption = False,
    force: ForceOption = False,
) -> None:
    """Deform TEMPLATE onto SCAN; vertices, faces, texture and attributes of TEMPLATE are kept.

    Where SCAN has nothing, TEMPLATE is carried on smoothly.
    """
    import time
    from dataclasses import asdict

    from esd.learning.model import load_model
    from esd.matching.correspondence import load_map
    from esd.mesh.convert import as_arrays
    from esd.mesh.io.meshes import check_mesh_path
    from esd.registration.register import register as register_meshes

    if map and landmarks:
        raise typer.BadParameter("Give --map or --landmarks, not both.")
    start = time.perf_counter()
    inputs = [template, scan, *([map] if map else []), *(landmarks or [])]
    destination(check_mesh_path(output), force=force, inputs=inputs)
    if output.suffix.lower() == ".obj":  # with a texture, two files beside
        for suffix in (".mtl", ".png"):
            beside = [template.with_suffix(suffix)]
            destination(output.with_suffix(suffix), force=force, inputs=[*inputs, *beside])
    known = None
    if map:
        counts = []
        for file in (template, scan):
            with about(file):
                counts.append(len(as_arrays(file)[0]))
        known = load_map(map, source_count=counts[0], target_count=counts[1])
    loaded = load_model(model, device=device) if known is None else model
    _, pairs = landmark_pairs(landmarks or [], template, scan)
    with progress("registering"), about(f"{template}' and '{scan}"):
        result = register_meshes(
            template, scan, correspondence=known, model=loaded, landmarks=pairs
        )
    _write(template, result.mesh, output)
    judged = result.match.judgement
    summary = {
        "vertices": len(result.mesh.vertices),
        **asdict(result.quality),
        "relative_distance": result.quality.relative_distance,
        "verdict_of_the_map": judged.verdict if judged else None,
        "seconds": time.perf_counter() - start,
    }
    if as_json:
        typer.echo(json.dumps(summary))
        return
    figures = result.quality
    tell(
        f"{figures.relative_distance:.2%} of the extent from the scan on average, "
        f"{figures.supported:.0%} of the vertices supported by it, {figures.inverted} faces "
        f"inverted; written to {output}"
    )
    if judged and judged.verdict != "good":
        tell(f"The map is {judged.verdict}. {judged.advice}")


def _write(template: Path, mesh: Mesh, path: Path) -> None:
    """Write the mesh with the texture or the vertex attributes of the template's file."""
    from esd.common import InputError, whole_file
    from esd.mesh.io.meshes import write_mesh
    from esd.mesh.io.ply import ply_bytes, ply_elements
    from esd.mesh.io.textures import TEXTURE_FORMATS, read_texture, write_textured

    suffixes = template.suffix.lower(), path.suffix.lower()
    if all(suffix in TEXTURE_FORMATS for suffix in suffixes):
        try:
            texture = read_texture(template)
        except InputError:  # it has none
            write_mesh(mesh, path)
            return
        if len(texture.coordinates) == len(mesh.faces):
            write_textured(mesh, texture, path)
            return
    if suffixes == (".ply", ".ply"):
        placed = ("x", "y", "z", "nx", "ny", "nz")  # normals are no longer those
        kept = {
            name: values
            for name, values in ply_elements(template)["vertex"].items()
            if name not in placed and not isinstance(values, tuple)
        }
        with whole_file(path) as temporary:
            temporary.write_bytes(ply_bytes(mesh, kept))
        return
    write_mesh(mesh, path)
