"""`esd transfer`."""

from __future__ import annotations

from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from esd.cli.options import ForceOption, MapArgument, SourceArgument, TargetArgument
from esd.cli.output import about, destination, tell
from esd.cli.progress import progress
from esd.cli.shapes import read_drawable, read_map, read_shape

if TYPE_CHECKING:
    from esd.matching.correspondence import Correspondence


class Method(str, Enum):
    """How a place on the target is found on the source."""

    barycentric = "barycentric"
    nearest = "nearest"


def transfer(
    source: SourceArgument,
    target: TargetArgument,
    map: MapArgument,
    texture: Annotated[
        bool, typer.Option("--texture", help="Carry SOURCE's texture; writes .obj or .glb.")
    ] = False,
    vertex_colors: Annotated[
        bool, typer.Option("--vertex-colors", help="Carry SOURCE's colours; writes .ply or .glb.")
    ] = False,
    labels: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Carry labels of vertices or faces, one a line or .npy."),
    ] = None,
    values: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Carry numbers at vertices: .npy, .csv or .txt."),
    ] = None,
    landmarks: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Carry landmarks: .csv of name,vertex or name,x,y,z."),
    ] = None,
    morph: Annotated[
        int | None,
        typer.Option(min=2, metavar="N", help="Write N shapes from SOURCE to its image on TARGET."),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", metavar="FILE", help="What to write, for --morph a folder."),
    ] = None,
    method: Annotated[
        Method, typer.Option(help="Interpolate in the faces, or take the nearest matched vertex.")
    ] = Method.barycentric,
    force: ForceOption = False,
) -> None:
    """Transfer data on SOURCE to TARGET, along a map from SOURCE to TARGET.

    Give one of --texture, --vertex-colors, --labels, --values, --landmarks and --morph.
    """
    from esd.mesh.convert import as_arrays

    wanted = {
        "texture": texture,
        "colours": vertex_colors,
        "labels": labels,
        "values": values,
        "landmarks": landmarks,
        "morph": morph,
    }
    chosen = [name for name, value in wanted.items() if value]
    if len(chosen) != 1:
        raise typer.BadParameter(
            "Give one of --texture, --vertex-colors, --labels, --values, --landmarks and --morph."
        )
    what = chosen[0]
    given = labels or values
    suffix = {"texture": ".obj", "colours": ".ply", "landmarks": ".csv", "morph": ""}.get(
        what, given.suffix if given else ""
    )
    path = output or Path(f"{target.stem}-{what}{suffix}")
    _check_destination(path, what, [source, target, map, *filter(None, (given, landmarks))], force)
    with progress("transferring"):
        counts = []
        for file in (source, target):
            with about(file):
                counts.append(len(as_arrays(file)[0]))
        match = read_map(map, source_count=counts[0], target_count=counts[1])
        if landmarks:
            _transfer_landmarks(landmarks, source, target, match, path)
        elif morph:
            _write_morph(source, target, match, path, morph)
        elif texture:
            _transfer_texture(source, target, match, path)
        else:
            _transfer_fields(source, target, labels, values, match, path, method)
    tell(f"written to {path}")


def _check_destination(path: Path, what: str, inputs: list[Path], force: bool) -> None:
    """Refuse a wrong suffix, and to write on an input or a file that exists, before any work."""
    from esd.common import InputError
    from esd.mesh.io.landmarks import LANDMARK_FORMATS
    from esd.mesh.io.textures import TEXTURE_FORMATS

    suffixes = {
        "texture": TEXTURE_FORMATS,
        "colours": (".ply", ".glb"),
        "landmarks": tuple(LANDMARK_FORMATS),
        "labels": (".npy", ".csv", ".txt"),
        "values": (".npy", ".csv", ".txt"),
    }
    if what in suffixes and not path.name.lower().endswith(suffixes[what]):
        things = "textures" if what == "texture" else what
        raise InputError(f"'{path}': {things} are written to {', '.join(suffixes[what])}.")
    destination(path, force=force, inputs=inputs, is_folder=what == "morph")
    if what == "texture" and path.suffix.lower() == ".obj":
        beside = [inputs[0].with_suffix(suffix) for suffix in (".mtl", ".png")]
        for suffix in (".mtl", ".png"):
            destination(path.with_suffix(suffix), force=force, inputs=[*inputs, *beside])


def _transfer_landmarks(
    file: Path, source: Path, target: Path, match: Correspondence, path: Path
) -> None:
    from dataclasses import replace

    from esd.matching.along import transfer as along
    from esd.mesh.io.landmarks import read_landmarks, write_landmarks

    landmarks = read_landmarks(file, read_shape(source))
    carried = along(landmarks.vertices, source, target, match, kind="landmarks")
    write_landmarks(replace(landmarks, vertices=carried), read_shape(target), path)


def _write_morph(
    source: Path, target: Path, match: Correspondence, folder: Path, count: int
) -> None:
    from esd.matching.transfer import in_between
    from esd.mesh.io.meshes import write_mesh

    shapes = in_between(read_drawable(source), read_drawable(target), match, count=count)
    for i, shape in enumerate(shapes):
        write_mesh(shape, folder / f"{i:0{len(str(count - 1))}d}.ply")


def _transfer_texture(source: Path, target: Path, match: Correspondence, path: Path) -> None:
    from dataclasses import replace

    from esd.matching.along import transferred_texture
    from esd.mesh.io.textures import read_texture, write_textured

    texture = read_texture(source)
    mesh = read_drawable(target)
    coordinates = transferred_texture(texture.coordinates, source, mesh, match)
    write_textured(mesh, replace(texture, coordinates=coordinates), path)


def _transfer_fields(
    source: Path,
    target: Path,
    labels: Path | None,
    values: Path | None,
    match: Correspondence,
    path: Path,
    method: Method,
) -> None:
    import numpy as np

    from esd.matching.along import transfer as along
    from esd.mesh.io.attributes import read_vertex_colours, write_coloured
    from esd.mesh.io.fields import read_labels, read_values, write_labels, write_values

    if labels:
        marks, names = read_labels(labels)
        with about(labels):
            carried = along(marks, source, target, match, kind="labels", method=method.value)
        write_labels(carried, path, names)
    elif values:
        known = read_values(values)
        with about(values):
            carried = along(known, source, target, match, kind="values", method=method.value)
        write_values(carried, path)
    else:
        mesh = read_drawable(target)
        colours = along(
            read_vertex_colours(source), source, target, match, kind="values", method=method.value
        )
        write_coloured(mesh, np.round(np.nan_to_num(colours)).astype(np.uint8), path)
