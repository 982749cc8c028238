"""`esd precompute`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from esd.cli.options import (
    DatasetArgument,
    ForceOption,
    PatienceOption,
    SchedulerOption,
    WorkersOption,
    workers_of,
)
from esd.cli.output import destination, tell


def precompute(
    dataset: DatasetArgument,
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="STORE", help="HDF5 file; ends in .h5.")
    ],
    include: Annotated[
        str | None, typer.Option(metavar="GLOB", help="Only shapes with such names.")
    ] = None,
    preset: Annotated[
        str | None, typer.Option(help="Of the training that the descriptors are for: {presets}.")
    ] = None,
    model: Annotated[
        str | None,
        typer.Option(
            "--model",
            "-m",
            metavar="MODEL",
            help="Instead: a model whose descriptors are taken; by default 'default'.",
        ),
    ] = None,
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
    patience: PatienceOption = 60.0,
    as_json: Annotated[bool, typer.Option("--json", help="Print a summary as JSON.")] = False,
    force: ForceOption = False,
) -> None:
    """Write the descriptors of all shapes of DATASET to a store that esd train reads.

    A store that exists is brought up to date: only shapes that are new or have changed are
    computed, and an interrupted run resumes when rerun. --force makes it anew.
    """
    import time

    from esd.cli.progress import progress
    from esd.common import InputError
    from esd.datasets.open import open_collection
    from esd.datasets.precompute import precompute as precompute_collection
    from esd.datasets.store import is_store
    from esd.learning.model import load_model
    from esd.learning.presets import preset as named_preset

    start = time.perf_counter()
    if preset and model:
        raise typer.BadParameter("Give --preset or --model, not both.")
    computing = workers_of(workers, scheduler, patience)
    if output.suffix.lower() not in (".h5", ".hdf5"):
        raise InputError(f"'{output}': stores are written to .h5 files.")
    destination(output, force=True, inputs=[dataset])
    if force and output.exists() and not is_store(output):
        raise InputError(f"'{output}' is no store, and is not replaced; choose another name.")
    training = named_preset(preset) if preset else None
    if training and training.blocks:
        raise InputError(
            f"The preset '{preset}' learns from surfaces, which a store does not hold: give "
            "the data set itself to `esd train`."
        )
    recipe = training.recipe if training else load_model(model or "default").recipe
    remeshings = training.remeshings if training else 0
    # workers of a cluster may run in other folders
    collection = open_collection(Path(dataset).resolve() if Path(dataset).exists() else dataset)
    if collection.store is not None:
        raise InputError(f"'{dataset}' is a store already; name the data set it was made of.")
    if include:
        collection = collection.including(include)
    total = len(collection.shapes) * (1 + remeshings)
    with progress("describing", total) as advance:
        done = precompute_collection(
            collection,
            recipe,
            output,
            remeshings=remeshings,
            workers=computing,
            renew=force,
            on_shape=lambda: advance(1),
        )
    summary = {
        "store": str(output),
        "computed": done.computed,
        "unchanged": done.unchanged,
        "failed": dict(done.failures),
        "seconds": time.perf_counter() - start,
    }
    if as_json:
        typer.echo(json.dumps(summary))
    else:
        for name, reason in done.failures:
            typer.echo(f"{name}\t{reason}")
        tell(f"{done.computed} shapes computed, {done.unchanged} unchanged: {output}")
    if done.failures:
        raise InputError(
            f"{len(done.failures)} of {total} shapes failed; the others are in '{output}'. Run "
            "the command again when these are repaired."
        )
