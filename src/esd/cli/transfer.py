"""`esd transfer`."""

from __future__ import annotations

from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from esd.cli.options import ForceOption, MapArgument, SourceArgument, TargetArgument
from esd.cli.output import free_path, tell

if TYPE_CHECKING:
    from esd.matching.correspondence import Correspondence
    from esd.mesh.mesh import Mesh


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
    """Carry what you have on SOURCE to TARGET, along a map from SOURCE to TARGET.

    Give one of --texture, --vertex-colors, --labels, --values, --landmarks and --morph.
    """
    from esd.common import InputError
    from esd.matching.correspondence import load_map
    from esd.mesh.convert import as_mesh

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
        raise InputError(
            "Give one of --texture, --vertex-colors, --labels, --values, --landmarks and --morph."
        )
    given = labels or values
    suffix = {"texture": ".obj", "colours": ".ply", "landmarks": ".csv", "morph": ""}.get(
        chosen[0], given.suffix if given else ""
    )
    path = free_path(output or Path(f"{target.stem}-{chosen[0]}{suffix}"), force=force)
    meshes = as_mesh(source), as_mesh(target)
    match = load_map(
        map, source_count=len(meshes[0].vertices), target_count=len(meshes[1].vertices)
    )
    if landmarks:
        _transfer_landmarks(landmarks, meshes, match, path)
    elif morph:
        _write_morph(meshes, match, path, morph)
    elif texture:
        _transfer_texture(source, meshes, match, path)
    else:
        _transfer_fields(source, labels, values, meshes, match, path, method)
    tell(f"written to {path}")


def _transfer_landmarks(
    file: Path, meshes: tuple[Mesh, Mesh], match: Correspondence, path: Path
) -> None:
    from dataclasses import replace

    from esd.matching.transfer import carried_landmarks
    from esd.mesh.io.landmarks import read_landmarks, write_landmarks

    landmarks = read_landmarks(file, meshes[0])
    carried = replace(landmarks, vertices=carried_landmarks(landmarks.vertices, match))
    write_landmarks(carried, meshes[1], path)


def _write_morph(
    meshes: tuple[Mesh, Mesh], match: Correspondence, folder: Path, count: int
) -> None:
    from esd.matching.transfer import in_between
    from esd.mesh.io.meshes import write_mesh

    shapes = in_between(*meshes, match, count=count)
    folder.mkdir(exist_ok=True)
    for i, shape in enumerate(shapes):
        write_mesh(shape, folder / f"{i:0{len(str(count - 1))}d}.ply")


def _transfer_texture(
    source: Path, meshes: tuple[Mesh, Mesh], match: Correspondence, path: Path
) -> None:
    from dataclasses import replace

    from esd.matching.transfer import carried_texture
    from esd.mesh.io.attributes import read_texture, write_textured

    texture = read_texture(source)
    coordinates = carried_texture(texture.coordinates, *meshes, match)
    write_textured(meshes[1], replace(texture, coordinates=coordinates), path)


def _transfer_fields(
    source: Path,
    labels: Path | None,
    values: Path | None,
    meshes: tuple[Mesh, Mesh],
    match: Correspondence,
    path: Path,
    method: Method,
) -> None:
    import numpy as np

    from esd.matching import transfer as along
    from esd.mesh.io.attributes import read_vertex_colours, write_coloured
    from esd.mesh.io.fields import read_labels, read_values, write_labels, write_values

    source_mesh, target_mesh = meshes
    if labels:
        marks, names = read_labels(labels)
        if len(marks) == len(source_mesh.faces) != len(source_mesh.vertices):
            places = along.face_places(*meshes, match, method=method.value)
            marks = along.carried_face_labels(marks, source_mesh, places)
        else:
            places = along.vertex_places(*meshes, match, method=method.value)
            marks = along.carried_labels(marks, source_mesh, places)
        write_labels(marks, path, names)
        return
    places = along.vertex_places(*meshes, match, method=method.value)
    if values:
        write_values(along.carried_values(read_values(values), source_mesh, places), path)
    else:
        colours = along.carried_values(
            read_vertex_colours(source).astype(float), source_mesh, places
        )
        write_coloured(target_mesh, np.round(np.nan_to_num(colours)).astype(np.uint8), path)
