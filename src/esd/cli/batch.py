"""`esd batch`."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from esd.cli.options import (
    CandidatesOption,
    CoarseOption,
    DeviceOption,
    ForceOption,
    FullOption,
    JsonOption,
    Mirror,
    MirrorOption,
    ModelOption,
    OneToOneOption,
    RefineOption,
    RejectOption,
    RepairOption,
    SchedulerOption,
    WorkersOption,
    candidate_names,
    workers_of,
)
from esd.cli.output import free_path, tell
from esd.cli.progress import progress


def batch(
    pairs: Annotated[
        Path,
        typer.Argument(
            metavar="PAIRS",
            help="A .csv file with the columns source, target and, if wanted, output; names "
            "relative to its folder.",
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
    candidates: CandidatesOption = None,
    reject: RejectOption = False,
    one_to_one: OneToOneOption = False,
    coarse: CoarseOption = None,
    full: FullOption = False,
    repair: RepairOption = False,
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
    device: DeviceOption = "cpu",
    as_json: JsonOption = False,
    force: ForceOption = False,
) -> None:
    """Map many pairs of shapes on all cores, as esd match does; each shape is described once."""
    import time

    from esd.common import InputError
    from esd.learning.model import load_model
    from esd.matching.batch import match_files, read_pairs_of_files

    computing = workers_of(workers, scheduler)
    start = time.perf_counter()
    if scheduler:  # its workers may run in other folders
        pairs, output = pairs.resolve(), output.resolve()
    listed = read_pairs_of_files(pairs, folder=output)
    for pair in listed:
        free_path(pair.output, force=force)
    loaded = load_model(model, device=device)
    steps = len(listed) + len({file for pair in listed for file in (pair.source, pair.target)})
    maps, failed = [], 0
    with progress("matching", steps) as advance:
        for done in match_files(
            listed,
            model=loaded,
            refine=refine,
            candidates=candidate_names(candidates),
            mirror=mirror.value,
            reject=reject,
            one_to_one=one_to_one,
            everything=repair,
            coarse=coarse,
            full=full,
            workers=computing,
            on_step=lambda: advance(1),
        ):
            names = {key: str(getattr(done.pair, key)) for key in ("source", "target", "output")}
            maps.append({**names, **{k: v for k, v in asdict(done).items() if k != "pair"}})
            failed += done.failure is not None
            if not as_json and done.failure:
                typer.echo(f"{done.pair.output}\t{done.failure}")
    if as_json:
        seconds = time.perf_counter() - start
        typer.echo(json.dumps({"model": loaded.name, "maps": maps, "seconds": seconds}))
    else:
        tell(f"{len(listed) - failed} of {len(listed)} pairs matched")
    if failed:
        raise InputError(f"{failed} of {len(listed)} pairs failed; the other maps are written.")
