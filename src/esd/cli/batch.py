"""`esd batch`."""

from __future__ import annotations

import json
import os
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from esd.cli.options import (
    AdaptOption,
    CandidatesOption,
    CoarseOption,
    DeviceOption,
    ForceOption,
    FullOption,
    JsonOption,
    MinConfidenceOption,
    Mirror,
    MirrorOption,
    ModelOption,
    OneToOneOption,
    PatienceOption,
    RefineOption,
    RejectOption,
    RepairOption,
    Scale,
    ScaleOption,
    SchedulerOption,
    WorkersOption,
    candidate_names,
    check_coarse,
    check_threshold,
    workers_of,
)
from esd.cli.output import destination, tell
from esd.cli.progress import progress


def batch(
    pairs: Annotated[
        Path,
        typer.Argument(
            metavar="PAIRS",
            help="A .csv file with the columns source, target and, if wanted, output, "
            "source_landmarks and target_landmarks; names relative to its folder.",
        ),
    ],
    output: Annotated[
        Path,
        typer.Option(
            "--output", "-o", metavar="DIR", help="Folder of the maps that have no output."
        ),
    ] = Path(),
    model: ModelOption = "default",
    refine: RefineOption = None,
    mirror: MirrorOption = Mirror.auto,
    scale: ScaleOption = Scale.auto,
    candidates: CandidatesOption = None,
    adapt: AdaptOption = False,
    reject: RejectOption = False,
    min_confidence: MinConfidenceOption = 0.0,
    collection: Annotated[
        bool,
        typer.Option(
            "--collection",
            help="Match the shapes as a whole: by way of others where the judge finds that better; "
            "for all pairs of a collection, or many.",
        ),
    ] = False,
    one_to_one: OneToOneOption = False,
    coarse: CoarseOption = None,
    full: FullOption = False,
    repair: RepairOption = False,
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
    patience: PatienceOption = 60.0,
    device: DeviceOption = "cpu",
    as_json: JsonOption = False,
    force: ForceOption = False,
) -> None:
    """Map many pairs of shapes on all cores, as esd match does; each shape is described once."""
    import time

    from esd.common import InputError
    from esd.learning.model import load_model
    from esd.matching.adapt import check_adaptation
    from esd.matching.batch import CollectionReport, match_files, read_pairs_of_files

    check_coarse(coarse, one_to_one=one_to_one, full=full)
    chosen_from = candidate_names(candidates, landmarks=True)
    computing = workers_of(workers, scheduler, patience)
    start = time.perf_counter()
    if scheduler:  # its workers may run in other folders
        pairs, output = pairs.resolve(), output.resolve()
    listed = read_pairs_of_files(pairs, folder=output)
    inputs = {pairs, *(file for pair in listed for file in (pair.source, pair.target))}
    read = {os.path.realpath(file) for file in inputs}
    for pair in listed:
        destination(pair.output, force=force, inputs=[*read & {os.path.realpath(pair.output)}])
    loaded = load_model(model, device=device)
    if reject:
        check_threshold(loaded)
    if adapt:
        check_adaptation(loaded)
    steps = len(listed) + len({file for pair in listed for file in (pair.source, pair.target)})
    maps, failed = [], 0
    reports: list[CollectionReport] = []
    with progress("matching", steps) as advance:
        for done in match_files(
            listed,
            model=loaded,
            refine=refine,
            candidates=chosen_from,
            mirror=mirror.value,
            scale=scale.value,
            adapt=adapt,
            reject=reject,
            min_confidence=min_confidence,
            one_to_one=one_to_one,
            everything=repair,
            coarse=coarse,
            full=full,
            workers=computing,
            on_step=lambda: advance(1),
            on_collection=reports.append if collection else None,
        ):
            names = {key: str(getattr(done.pair, key)) for key in ("source", "target", "output")}
            maps.append({**names, **{k: v for k, v in asdict(done).items() if k != "pair"}})
            failed += done.failure is not None
            if not as_json and done.failure:
                typer.echo(f"{done.pair.output}\t{done.failure}")
            elif not as_json and done.not_repaired and done.verdict != "good":
                said = f"{done.verdict or 'not judged'}; not repaired: {done.not_repaired}"
                typer.echo(f"{done.pair.output}\t{said}")
    if as_json:
        seconds = time.perf_counter() - start
        summary = {"model": loaded.name, "maps": maps, "seconds": seconds}
        if reports:
            summary["collection"] = asdict(reports[0])
        typer.echo(json.dumps(summary))
    else:
        tell(f"{len(listed) - failed} of {len(listed)} pairs matched")
        for report in reports:
            tell(report.in_a_line())
    if failed:
        others = "; the other maps are written" if failed < len(listed) else ""
        raise InputError(f"{failed} of {len(listed)} pairs failed{others}.")
