"""`esd evaluate`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from esd.cli.match import ModelOption, RefineOption, RejectOption
from esd.cli.output import tell
from esd.cli.train import DatasetArgument


def evaluate(
    dataset: DatasetArgument,
    model: ModelOption = "default",
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
    as_json: Annotated[bool, typer.Option("--json", help="Print the figures as JSON.")] = False,
) -> None:
    """Measure how far a model's maps are from the known correspondences of DATASET.

    Without --pairs or --include, all pairs of different subjects are mapped, of 'bodies' only
    those of the subjects kept for testing.
    """
    import os
    from dataclasses import asdict

    from esd.cli.progress import progress
    from esd.common import InputError
    from esd.datasets.collection import read_pairs
    from esd.datasets.open import open_collection
    from esd.evaluation.protocol import evaluate as evaluate_model
    from esd.learning.model import load_model
    from esd.spectral.cache import default_cache

    if pairs and include:
        raise InputError("Give --pairs or --include, not both.")
    loaded = load_model(model)
    collection = open_collection(dataset)
    if pairs:
        chosen = read_pairs(pairs, collection)
    elif include:
        chosen = collection.including(include).pairs()
    else:
        kept = collection.testing_subjects or collection.subjects
        chosen = collection.of_subjects(kept).pairs()
    with progress("evaluating", len(chosen)) as went:
        result, _ = evaluate_model(
            loaded,
            chosen,
            refine=refine,
            reject=reject,
            processes=os.cpu_count() or 1,
            cache=default_cache(),
            on_pair=lambda: went(1),
        )
    figures = {key: value for key, value in asdict(result).items() if value is not None}
    if as_json:
        typer.echo(json.dumps({"model": loaded.name, "data": collection.name, **figures}))
        return
    tell(f"{loaded.name} on {collection.name}; errors over √area, means over pairs")
    for key, value in figures.items():
        tell(f"  {key:34} {value:.4g}" if isinstance(value, float) else f"  {key:34} {value}")
