"""`esd train`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from esd.cli.options import DatasetArgument, ForceOption
from esd.cli.output import free_path, tell


def train(
    dataset: DatasetArgument,
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="MODEL", help="Folder to write the model to.")
    ],
    preset: Annotated[
        str,
        typer.Option(
            help="oriented, paper-hks, paper-wks, paper-gps, osd, osd-geometry, gcnn or acnn."
        ),
    ],
    include: Annotated[
        str | None, typer.Option(metavar="GLOB", help="Only shapes with such names.")
    ] = None,
    validation: Annotated[
        str | None,
        typer.Option(
            metavar="GLOB",
            help="Shapes kept out of the training, on which the best weights are chosen.",
        ),
    ] = None,
    hold_out: Annotated[
        int, typer.Option(min=0, help="Instead: number of subjects kept out, drawn by the seed.")
    ] = 0,
    seed: Annotated[int, typer.Option(min=0, help="Of all that is random.")] = 0,
    steps: Annotated[int | None, typer.Option(min=1, help="Instead of the preset's.")] = None,
    standardise: Annotated[
        bool, typer.Option(help="Standardise the descriptors over the training shapes.")
    ] = True,
    log: Annotated[bool, typer.Option(help="Take the logarithm of the descriptors.")] = False,
    device: Annotated[
        str, typer.Option(metavar="[cpu|cuda|auto]", help="Where the network is trained.")
    ] = "cpu",
    force: ForceOption = False,
) -> None:
    """Train a model on the shapes of DATASET; an interrupted training goes on when called again."""
    from dataclasses import replace

    from esd.cli.progress import progress
    from esd.datasets.open import open_collection
    from esd.datasets.splits import split_by_subject
    from esd.learning.fit import fit
    from esd.learning.model import check_model_destination, save_model
    from esd.learning.presets import preset as named_preset
    from esd.spectral.cache import default_cache

    training = replace(named_preset(preset), standardise=standardise)
    if steps is not None:
        training = replace(training, steps=steps)
    if log:
        parts = tuple(replace(part, log=True) for part in training.recipe.descriptors)
        training = replace(training, recipe=replace(training.recipe, descriptors=parts))
    check_model_destination(output)
    free_path(output, force=force)
    whole = open_collection(dataset)
    chosen = whole.including(include) if include else whole
    chosen = chosen.excluding_subjects(whole.testing_subjects)
    held = None
    if validation and hold_out:
        raise typer.BadParameter("Give --validation or --hold-out, not both.")
    if validation:
        held = whole.including(validation)
        chosen = chosen.excluding_subjects(held.subjects)
    elif hold_out:
        chosen, held = split_by_subject(chosen, held_out=hold_out, seed=seed)
    shapes = 0 if whole.store else len(chosen.shapes) + (len(held.shapes) if held else 0)
    done = 0
    with progress("describing", shapes) as described, progress("training", training.steps) as went:

        def advance(state: object) -> None:
            nonlocal done
            step = getattr(state, "step", done)
            went(step - done)
            done = step

        model = fit(
            chosen,
            training,
            name=output.name,
            seed=seed,
            validation=held,
            checkpoint=output.with_name(output.name + ".checkpoint"),
            device=device,
            cache=default_cache(),
            on_shape=lambda: described(1),
            on_progress=advance,
        )
    save_model(model, output)
    tell(f"trained {model.card['steps_done']} steps on {len(chosen.shapes)} shapes: {output}")
