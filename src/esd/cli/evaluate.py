"""`esd evaluate`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from esd.cli.options import (
    DatasetArgument,
    DeviceOption,
    ForceOption,
    PatienceOption,
    RefineOption,
    RejectOption,
    SchedulerOption,
    WorkersOption,
    check_threshold,
    workers_of,
)
from esd.cli.output import destination, tell


def evaluate(
    dataset: DatasetArgument,
    model: Annotated[
        list[str],
        typer.Option(
            "--model",
            "-m",
            metavar="MODEL",
            help="A model folder, or {models}, or {descriptors}; several times to compare.",
        ),
    ] = ["default"],  # noqa: B006
    pairs: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Lines of two shape names with a tab: source, target."),
    ] = None,
    include: Annotated[
        str | None,
        typer.Option(
            metavar="GLOB",
            help="All pairs of different subjects among these shapes; by default among all, "
            "or among those that the data set keeps for testing.",
        ),
    ] = None,
    refine: RefineOption = None,
    reject: RejectOption = False,
    rotate: Annotated[
        int | None,
        typer.Option(
            metavar="SEED",
            min=0,
            help="Rotate each shape at random by this seed first: files of a data set mostly face "
            "one way, which scans do not.",
        ),
    ] = None,
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
    patience: PatienceOption = 60.0,
    device: DeviceOption = "cpu",
    plot: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Draw the share of points within an error, over √area and over the diameter, to "
            "a .png, .pdf or .svg.",
        ),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the figures as JSON.")] = False,
    force: ForceOption = False,
) -> None:
    """Measure how far the maps of models are from the known correspondences of DATASET.

    Without --pairs or --include, all pairs of different subjects are mapped, of 'bodies' only
    those of the subjects held out for testing.
    """
    from dataclasses import asdict

    from esd.cli.progress import progress
    from esd.datasets.collection import read_pairs
    from esd.datasets.open import open_collection
    from esd.evaluation.protocol import evaluate as evaluate_model
    from esd.learning.model import load_model
    from esd.spectral.cache import default_cache

    if pairs and include:
        raise typer.BadParameter("Give --pairs or --include, not both.")
    computing = workers_of(workers, scheduler, patience)
    if plot:
        # before the work, which can take long
        from esd.viewing.figures import check_figure_path, errors_figure, save_figure

        destination(
            check_figure_path(plot), force=force, inputs=[dataset, *([pairs] if pairs else [])]
        )
    models = [load_model(name, device=device) for name in dict.fromkeys(model)]
    if reject:
        for loaded in models:
            check_threshold(loaded)
    # workers of a cluster may run in other folders
    collection = open_collection(Path(dataset).resolve() if Path(dataset).exists() else dataset)
    if pairs:
        chosen = read_pairs(pairs, collection)
    elif include:
        chosen = collection.including(include).pairs()
    else:
        kept = collection.testing_subjects or collection.subjects
        chosen = collection.of_subjects(kept).pairs()
    figures, errors = [], {}
    steps = len(chosen) + len({shape.name for pair in chosen for shape in pair})
    with progress("evaluating", steps * len(models)) as advance:
        for name, loaded in zip(dict.fromkeys(model), models, strict=True):
            result, found = evaluate_model(
                loaded,
                chosen,
                refine=refine,
                reject=reject,
                rotate=rotate,
                workers=computing,
                cache=default_cache(),
                on_step=lambda: advance(1),
            )
            measured = {key: value for key, value in asdict(result).items() if value is not None}
            figures.append({"model": loaded.name, "data": collection.name, **measured})
            alone = [other.name for other in models].count(loaded.name) == 1
            errors[loaded.name if alone else name] = found
    if plot:
        save_figure(errors_figure(errors), plot)
    if as_json:
        typer.echo(json.dumps(figures[0] if len(figures) == 1 else {"models": figures}))
        return
    tell(f"on {collection.name}; errors over √area, means over pairs")
    for key in dict.fromkeys(key for figure in figures for key in figure):
        if key not in ("data", "confidence_bins", "verdicts"):
            cells = (figure.get(key, "") for figure in figures)
            tell(f"  {key:34}" + "".join(f" {_text(cell):>12}" for cell in cells))
    for figure in figures:
        for verdict, maps in figure["verdicts"].items():
            tell(
                f"  {figure['model']}: {maps['maps']} {verdict}; right on average "
                f"{maps['right']:.1%} (expected {maps['expected']:.1%}), at least "
                f"{maps['least_right']:.1%}"
            )
    if plot:
        tell(f"drawn to {plot}")


def _text(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
