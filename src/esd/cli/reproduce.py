"""`esd reproduce`."""

from __future__ import annotations

from enum import Enum
from pathlib import Path
from typing import Annotated

import typer

from esd.cli.options import ForceOption
from esd.cli.output import destination, tell
from esd.experiments.catalogue import EXPERIMENTS

Experiment = Enum("Experiment", {name: name for name in EXPERIMENTS}, type=str)  # type: ignore[misc]


def reproduce(
    experiment: Annotated[
        Experiment,
        typer.Argument(
            help="A table or figure of the paper: "
            + "; ".join(f"{name} ({about})" for name, about in EXPERIMENTS.items())
            + "."
        ),
    ],
    data: Annotated[
        list[str],
        typer.Option(
            metavar="DATASET",
            help="bodies, bodies-registered, Dyna or D-FAUST, or a folder; "
            "for 'transfer' several times.",
        ),
    ],
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="DIR", help="Folder to write.")
    ] = Path("reproduced"),
    test: Annotated[
        str | None,
        typer.Option(
            metavar="GLOB",
            help="Shapes to test on; training leaves their subjects out. By default those the data "
            "set keeps for testing, or of the last quarter of its subjects.",
        ),
    ] = None,
    per_subject: Annotated[
        int, typer.Option(min=2, help="Shapes taken of each subject, at the most.")
    ] = 10,
    quick: Annotated[bool, typer.Option("--quick", help="A coarse answer, soon.")] = False,
    seed: Annotated[int, typer.Option(min=0, help="Of all that is random.")] = 0,
    force: ForceOption = False,
) -> None:
    """Repeat an experiment of the paper: figures, CSV tables and report.md, in DIR/EXPERIMENT.

    Finished parts are saved in DIR/parts and DIR/models: an interrupted experiment resumes when
    rerun, and several experiments share their trainings.
    """
    import shlex
    import sys
    import time
    from importlib import import_module

    from esd.cli.progress import progress
    from esd.datasets.open import open_collection
    from esd.datasets.splits import sample_by_subject, sample_subjects, unseen_subjects
    from esd.experiments.report import write_report
    from esd.experiments.setting import Setting, provenance
    from esd.experiments.table2 import TESTING_SUBJECTS, TRAINING_SUBJECTS
    from esd.spectral.cache import default_cache
    from esd.viewing.figures import save_figure

    if (len(data) > 1) != (experiment.value == "transfer"):
        raise typer.BadParameter(
            "'transfer' takes --data several times, the other experiments once."
        )
    module = import_module(f"esd.experiments.{experiment.value}")
    start = time.perf_counter()
    folder = output / experiment.value
    destination(folder, force=force, inputs=data, is_folder=True)
    destination(output, force=True, inputs=data, is_folder=True)
    settings = []
    for name in data:
        collection = sample_by_subject(open_collection(name), per_subject, seed=seed)
        compared = experiment.value == "table2"  # whose numbers of subjects the paper tells
        training, testing = unseen_subjects(
            collection, patterns=test, least=TESTING_SUBJECTS if compared else 2
        )
        if compared:
            training = sample_subjects(training, TRAINING_SUBJECTS, seed=seed)
            testing = sample_subjects(testing, TESTING_SUBJECTS, seed=seed)
        settings.append(
            Setting(
                training=training,
                testing=testing,
                folder=output,
                seed=seed,
                quick=quick,
                cache=default_cache(),
                progress=progress,
            )
        )
    folder.mkdir(parents=True, exist_ok=True)
    outcome = module.run(*settings)
    figures = module.figures(outcome)
    for name, figure in figures.items():
        for suffix in (".png", ".pdf"):
            save_figure(figure, folder / f"{name}{suffix}")
    facts = {
        "Command": f"`esd {shlex.join(sys.argv[1:])}`",
        **provenance(settings),
        "Seed": seed,
        "Time": f"{time.perf_counter() - start:.0f} s, less what an earlier run had finished",
    }
    write_report(outcome.report, folder, facts=facts, figures=list(figures))
    tell(f"written to {folder / 'report.md'}")
