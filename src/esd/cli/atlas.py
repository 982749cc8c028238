"""`esd atlas`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from esd.cli.options import (
    DeviceOption,
    ForceOption,
    JsonOption,
    PatienceOption,
    SchedulerOption,
    WorkersOption,
    workers_of,
)
from esd.cli.output import destination, tell
from esd.common import InputError

if TYPE_CHECKING:
    from esd.datasets.collection import Collection
    from esd.learning.model import Model
    from esd.parallel import Workers
    from esd.population.atlas import Atlas

_LISTED = 5  # shapes that are named in a line


def atlas(
    dataset: Annotated[
        str,
        typer.Argument(metavar="FOLDER", help="Meshes of one class; they need not correspond."),
    ],
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="DIR", help="Folder of the atlas.")
    ],
    template: Annotated[
        str,
        typer.Option(
            metavar="[MESH|auto]",
            help="Mesh that is registered to all shapes; auto: the shape nearest to all others.",
        ),
    ] = "auto",
    model: Annotated[
        str | None,
        typer.Option(
            "--model",
            "-m",
            metavar="MODEL",
            help="Of the maps: a model folder, or {models}; by default 'default'.",
            show_default=False,
        ),
    ] = None,
    train: Annotated[
        bool,
        typer.Option("--train", help="Instead: train one on FOLDER first, see esd train."),
    ] = False,
    landmarks: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER",
            help="Landmarks named as the shapes and the template; by default FOLDER/landmarks.",
            show_default=False,
        ),
    ] = None,
    registered: Annotated[
        bool,
        typer.Option("--registered", help="The meshes have one connectivity: match nothing."),
    ] = False,
    include: Annotated[
        str | None, typer.Option(metavar="GLOB", help="Only shapes with such names.")
    ] = None,
    modes: Annotated[
        int | None, typer.Option(min=1, help="Number of modes; all by default.", show_default=False)
    ] = None,
    keep_size: Annotated[
        bool, typer.Option("--keep-size", help="Move and rotate the shapes, but do not scale.")
    ] = False,
    keep_failed: Annotated[
        bool,
        typer.Option("--keep-failed", help="Use shapes whose map or registration failed, too."),
    ] = False,
    vertices: Annotated[
        int,
        typer.Option(min=300, help="An automatic template of more vertices is remeshed to these."),
    ] = 10_000,
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
    patience: PatienceOption = 60.0,
    device: DeviceOption = "cpu",
    as_json: JsonOption = False,
    force: ForceOption = False,
) -> None:
    """Register a template to all meshes of FOLDER; compute their mean shape and principal modes.

    DIR gets the registered meshes, the mean, a model of the population, scores as CSV, and a
    report. An interrupted run resumes when rerun; shapes that were added or changed are computed.
    """
    import time

    from esd.cli.progress import progress
    from esd.datasets.open import open_collection
    from esd.population.atlas import atlas as atlas_of
    from esd.population.atlas import is_atlas_folder
    from esd.population.files import save_atlas
    from esd.viewing.report import report

    start = time.perf_counter()
    if train and model:
        raise typer.BadParameter("Give --train or --model, not both.")
    if registered and (train or model or landmarks or template != "auto"):
        raise typer.BadParameter(
            "--registered matches nothing: leave out --train, --model, --landmarks and --template."
        )
    computing = workers_of(workers, scheduler, patience)
    inputs: list[Path | str] = [dataset, *([landmarks] if landmarks else [])]
    _check_apart(output, inputs)
    destination(
        output, force=force or is_atlas_folder(output), inputs=[*inputs, template], is_folder=True
    )
    # workers of a cluster may run in other folders
    data = Path(dataset).resolve() if Path(dataset).exists() else dataset
    collection = open_collection(data)
    if include:
        collection = collection.including(include)
    found_landmarks = landmarks or _own_landmarks(data)
    chosen = (
        None
        if registered
        else _model(collection, model, output, computing, train=train, device=device)
    )
    count = len(collection.shapes) * (1 if registered else 2)
    with progress("registering", count) as advance:
        found = atlas_of(
            collection,
            template=template,
            model=chosen or "default",
            landmarks=None if registered else found_landmarks,
            registered=registered,
            keep_size=keep_size,
            keep_failed=keep_failed,
            modes=modes,
            vertex_count=vertices,
            folder=output,
            renew=force,
            workers=computing,
            on_shape=lambda: advance(1),
        )
    save_atlas(found, output)
    report(found, title=collection.name).save(output / "report.html")
    _report(found, output, seconds=time.perf_counter() - start, as_json=as_json)


def _check_apart(output: Path, inputs: list[Path | str]) -> None:
    """Raise an `InputError` if the folder of the atlas lies in one that is read, or holds it."""
    place = output.resolve()
    for each in inputs:
        read = Path(each).resolve()
        if place == read or (read.is_dir() and (read in place.parents or place in read.parents)):
            raise InputError(
                f"'{output}' and '{each}', which is read, lie one in the other; choose a folder "
                "elsewhere."
            )


def _own_landmarks(data: Path | str) -> Path | None:
    folder = Path(data) / "landmarks"
    return folder if folder.is_dir() else None


def _model(
    collection: Collection,
    name: str | None,
    output: Path,
    workers: Workers,
    *,
    train: bool,
    device: str,
) -> Model:
    """The model of a name, or one that is trained on the shapes and kept in the output folder."""
    from esd.learning.model import load_model, save_model
    from esd.population.atlas import TRAINED

    place = output / TRAINED
    if not train:
        return load_model(name or "default", device=device)
    if place.is_dir():
        return load_model(place, device=device)
    from esd.cli.progress import progress
    from esd.learning.presets import preset
    from esd.learning.unsupervised import Teaching, TeachingProgress, train_unsupervised
    from esd.spectral.cache import default_cache

    output.mkdir(parents=True, exist_ok=True)
    done = 0
    with (
        progress("describing", len(collection.shapes)) as described,
        progress("training", Teaching().steps) as advance,
    ):

        def trained(state: TeachingProgress) -> None:
            nonlocal done
            advance(state.step - done)
            done = state.step

        model = train_unsupervised(
            collection,
            preset("oriented"),
            checkpoint=output / f"{TRAINED}.checkpoint",
            workers=workers,
            cache=default_cache(),
            on_shape=lambda: described(1),
            on_progress=trained,
        )
    save_model(model, place)
    return load_model(place, device=device)


def _report(found: Atlas, output: Path, *, seconds: float, as_json: bool) -> None:
    far = [name for name, is_far in zip(found.names, found.is_outlier, strict=True) if is_far]
    summary = {
        "folder": str(output),
        "template": found.template,
        "shapes": len(found.names),
        "computed": sum(each.is_new for each in found.shapes if not each.failure),
        "left_out": found.left_out,
        "outliers": [name for name, far in zip(found.names, found.is_outlier, strict=True) if far],
        "modes": len(found.modes),
        "explained": found.model.explained().tolist(),
        "seconds": seconds,
    }
    if as_json:
        typer.echo(json.dumps(summary))
        return
    for name, reason in found.left_out.items():
        tell(f"left out: {name}: {reason}")
    if far:
        more = f" and {len(far) - _LISTED} more" if len(far) > _LISTED else ""
        tell(f"far from the mean: {', '.join(far[:_LISTED])}{more}")
    share = found.model.explained()
    first = min(3, len(share))
    tell(
        f"{len(found.names)} shapes registered to '{found.template}'; {first} of {len(share)} "
        f"modes explain {share[first - 1] if first else 1:.0%} of the variance: {output}"
    )
