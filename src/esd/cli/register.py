"""`esd register`."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from esd.cli.options import DeviceOption, ForceOption, JsonOption, ModelOption
from esd.cli.output import about, destination, tell
from esd.cli.progress import progress
from esd.cli.shapes import landmark_pairs

if TYPE_CHECKING:
    from esd.mesh.convert import MeshLike
    from esd.registration.register import Registration


def register(
    template: Annotated[
        Path, typer.Argument(metavar="TEMPLATE", help="Mesh that is deformed; it needs faces.")
    ],
    scans: Annotated[
        list[Path],
        typer.Argument(
            metavar="SCAN...",
            help="Mesh or point cloud that it is deformed onto; several, or a folder, are the "
            "frames of an animation, each started from the last.",
        ),
    ],
    output: Annotated[
        Path,
        typer.Option(
            "--output",
            "-o",
            metavar="OUT",
            help="The template on the scan, .ply, .obj, .off, …; of an animation, a folder.",
        ),
    ],
    map: Annotated[
        Path | None,
        typer.Option(
            "--map", metavar="MAP", help="From TEMPLATE to the first SCAN; computed by default."
        ),
    ] = None,
    landmarks: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="FILE [FILE]",
            help="Landmarks of TEMPLATE and of the first SCAN, see esd match.",
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

    from esd.learning.model import load_model
    from esd.matching.correspondence import load_map
    from esd.mesh.convert import as_arrays
    from esd.mesh.io.attributes import write_mesh_like
    from esd.registration.register import register_sequence

    if map and landmarks:
        raise typer.BadParameter("Give --map or --landmarks, not both.")
    start = time.perf_counter()
    is_animation = len(scans) > 1 or scans[0].is_dir()
    frames = _frames(scans)
    inputs = [template, *scans, *([map] if map else []), *(landmarks or [])]
    outputs = _outputs(template, frames, output, is_animation=is_animation)
    if is_animation:
        destination(output, force=force, inputs=inputs, is_folder=True)
    for path in outputs:
        destination(path, force=force or is_animation, inputs=[*inputs, *frames])
        if path.suffix.lower() == ".obj":  # with a texture, two files beside
            for suffix in (".mtl", ".png"):
                beside = [template.with_suffix(suffix)]
                destination(
                    path.with_suffix(suffix),
                    force=force or is_animation,
                    inputs=[*inputs, *frames, *beside],
                )
    with about(template):
        mesh = as_arrays(template)  # each file is read once
    with about(frames[0]):
        first = as_arrays(frames[0])
    known = None
    if map:
        known = load_map(map, source_count=len(mesh[0]), target_count=len(first[0]))
    loaded = load_model(model, device=device) if known is None or is_animation else model
    _, pairs = landmark_pairs(landmarks or [], mesh, first)
    summaries = []
    with progress("registering", len(frames) if is_animation else None) as advance:
        found = register_sequence(
            mesh, _read(frames, first), correspondence=known, model=loaded, landmarks=pairs
        )
        for frame, path in zip(frames, outputs, strict=True):
            with about(f"{template}' and '{frame}"):
                result = next(found)
            write_mesh_like(result.mesh, path, original=template)
            summaries.append(_summary(result))
            if not as_json:
                _say(result, frame, path)
            advance(1)
    seconds = {"seconds": time.perf_counter() - start}
    if as_json and is_animation:
        named = [
            {"frame": frame.name, **each} for frame, each in zip(frames, summaries, strict=True)
        ]
        typer.echo(json.dumps({"frames": named, **seconds}))
    elif as_json:
        typer.echo(json.dumps({**summaries[0], **seconds}))


def _frames(scans: list[Path]) -> list[Path]:
    """The files of an animation: those given, or in order of their names those in a folder."""
    from esd.common import InputError
    from esd.mesh.io.meshes import FORMATS, POINT_FORMATS

    if not scans[0].is_dir():
        return scans
    if len(scans) > 1:
        raise typer.BadParameter("Give one folder of frames, or their files.")
    known = (*FORMATS, *POINT_FORMATS)
    files = [
        file
        for file in scans[0].iterdir()
        if file.suffix.lower() in known and not file.name.startswith(".")
    ]
    if not files:
        raise InputError(f"There is no mesh in '{scans[0]}' ({', '.join(known)}).")
    return sorted(files, key=_in_order)


def _in_order(file: Path) -> tuple[list[tuple[int, str]], str]:
    """Sorts frame 2 before frame 10."""
    import re

    parts = re.findall(r"\d+|\D+", file.stem)
    return [(int(part), "") if part.isdigit() else (-1, part) for part in parts], file.name


def _outputs(template: Path, frames: list[Path], output: Path, *, is_animation: bool) -> list[Path]:
    """Where the template on each scan is written."""
    from esd.common import InputError
    from esd.mesh.io.meshes import WRITTEN_FORMATS, check_mesh_path

    if not is_animation:
        return [check_mesh_path(output)]
    suffix = template.suffix.lower()
    suffix = suffix if suffix in WRITTEN_FORMATS else ".ply"
    paths = [output / f"{frame.stem}{suffix}" for frame in frames]
    if len(set(paths)) < len(paths):
        twice = next(path.stem for path in paths if paths.count(path) > 1)
        raise InputError(f"Several frames are named '{twice}'; give them different names.")
    return paths


def _read(frames: list[Path], first: MeshLike) -> Iterator[MeshLike]:
    from esd.mesh.convert import as_arrays

    yield first
    for frame in frames[1:]:
        with about(frame):
            yield as_arrays(frame)


def _summary(result: Registration) -> dict[str, Any]:
    from dataclasses import asdict

    judged = result.match.judgement if result.match else None
    return {
        "vertices": len(result.mesh.vertices),
        **asdict(result.quality),
        "relative_distance": result.quality.relative_distance,
        "by_map": result.match is not None,
        "verdict_of_the_map": judged.verdict if judged else None,
    }


def _say(result: Registration, frame: Path, path: Path) -> None:
    figures = result.quality
    tell(
        f"{frame.name}: {figures.relative_distance:.2%} of the extent from the scan on average, "
        f"{figures.supported:.0%} of the vertices supported by it, {figures.inverted} faces "
        f"inverted; written to {path}"
    )
    judged = result.match.judgement if result.match else None
    if judged and judged.verdict != "good":
        tell(f"The map is {judged.verdict}. {judged.advice}")
