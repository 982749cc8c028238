"""`esd match`."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from esd.cli.output import ForceOption, free_path, tell
from esd.cli.progress import progress

if TYPE_CHECKING:
    from esd.learning.model import Model

WorkersOption = Annotated[
    int | None,
    typer.Option(min=1, help="Processes; by default one for each core.", show_default=False),
]
SchedulerOption = Annotated[
    str | None,
    typer.Option(
        metavar="ADDRESS",
        help="Compute on the workers of a Dask scheduler, such as tcp://host:8786.",
    ),
]
ModelOption = Annotated[
    str,
    typer.Option(
        "--model", "-m", metavar="MODEL", help="A model folder, a bundled name, or hks, wks, gps."
    ),
]
RefineOption = Annotated[
    bool | None,
    typer.Option(
        "--refine/--no-refine",
        help="Refine by ZoomOut; by default if MODEL tells left from right.",
        show_default=False,
    ),
]
RejectOption = Annotated[
    bool, typer.Option("--reject", help="Drop matches beyond the model's threshold, C / 2.")
]
DeviceOption = Annotated[
    str,
    typer.Option(
        metavar="[cpu|cuda|auto]", help="Where embeddings, and the nearest of them, are computed."
    ),
]


def match(
    source: Annotated[
        Path | None, typer.Argument(help="Mesh whose vertices are mapped.", show_default=False)
    ] = None,
    target: Annotated[
        Path | None, typer.Argument(help="Mesh that they are mapped to.", show_default=False)
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            metavar="MAP",
            help="Ends in .csv, .npy, .txt or .vts; by default SOURCE-TARGET.csv. With --batch, "
            "the folder of the maps that have no output.",
        ),
    ] = None,
    model: ModelOption = "default",
    refine: RefineOption = None,
    reject: RejectOption = False,
    one_to_one: Annotated[
        bool,
        typer.Option("--one-to-one", help="Match no target vertex twice; some source ones not."),
    ] = False,
    coarse: Annotated[
        int | None,
        typer.Option(
            metavar="N",
            min=300,
            help="For dense meshes: match copies of about N vertices, such as 10000, and carry "
            "the map to all.",
            show_default=False,
        ),
    ] = None,
    view: Annotated[
        bool,
        typer.Option("--view", help="Also write a page that shows the map, and open it."),
    ] = False,
    repair: Annotated[
        bool,
        typer.Option("--repair", help="Repair all that esd doctor would, not the harmless alone."),
    ] = False,
    batch: Annotated[
        Path | None,
        typer.Option(
            metavar="PAIRS",
            help="Instead of SOURCE and TARGET: a .csv file of such, with the columns source, "
            "target and, if wanted, output; names relative to its folder.",
        ),
    ] = None,
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
    device: DeviceOption = "cpu",
    as_json: Annotated[bool, typer.Option("--json", help="Print a summary as JSON.")] = False,
    force: ForceOption = False,
) -> None:
    """Map each vertex of SOURCE to its vertex of TARGET.

    Meshes or points, broken ones as well: see esd doctor. The map is that of the files' vertices.
    """
    import time

    from esd.learning.model import load_model
    from esd.matching.correspondence import check_map_path, save_map
    from esd.matching.match import match as match_meshes
    from esd.mesh.repair.repair import repair as repaired
    from esd.mesh.repair.repair import usable_part

    if batch is not None:
        if source or view:
            raise typer.BadParameter("--batch takes neither SOURCE and TARGET nor --view.")
        if workers and scheduler:
            raise typer.BadParameter("Give --workers or --scheduler, not both.")
        options: dict[str, Any] = {"refine": refine, "reject": reject}
        options |= {"one_to_one": one_to_one, "everything": repair, "coarse": coarse}
        options |= {"workers": workers, "scheduler": scheduler}
        loaded = load_model(model, device=device)
        _match_batch(batch, output, loaded, as_json=as_json, force=force, **options)
        return
    if scheduler:
        raise typer.BadParameter("--scheduler goes with --batch.")
    if source is None or target is None:
        raise typer.BadParameter("SOURCE and TARGET are needed, or --batch PAIRS.")
    start = time.perf_counter()
    path = free_path(
        check_map_path(output or Path(f"{source.stem}-{target.stem}.csv")), force=force
    )
    page = path.with_suffix(".html")
    if view:
        free_path(page, force=force)
        drawn = usable_part(source), usable_part(target)
    loaded = load_model(model, device=device)
    shapes = [repaired(path, everything=repair, restore=True) for path in (source, target)]
    result = match_meshes(
        *shapes, model=loaded, refine=refine, one_to_one=one_to_one, coarse=coarse
    )
    if reject:
        result = result.rejecting(loaded.threshold())
    save_map(result, path)
    matched, judged = result.is_matched(), result.judgement
    summary = {
        "model": loaded.name,
        "source_vertices": len(shapes[0].vertex_index),
        "target_vertices": len(shapes[1].vertex_index),
        "matched": int(matched.sum()),
        "coverage": result.coverage(len(shapes[1].vertex_index)),
        "mean_confidence": float(result.confidence[matched].mean()) if matched.any() else 0.0,
        "source_findings": shapes[0].in_a_line(),
        "target_findings": shapes[1].in_a_line(),
        "verdict": judged.verdict if judged else None,
        "expected_accuracy_5pct_diameter": judged.expected_accuracy if judged else None,
        "orientation": judged.orientation if judged else None,
        "seconds": time.perf_counter() - start,
    }
    if as_json:
        typer.echo(json.dumps(summary))
    else:
        tell(
            f"{summary['matched']} of {summary['source_vertices']} vertices matched, covering "
            f"{summary['coverage']:.0%} of the target; written to {path}"
        )
        if judged:
            tell(
                f"{judged.verdict}: about {judged.expected_accuracy:.0%} within 5 % of the "
                f"diameter. {judged.advice}".rstrip()
            )
    if view:
        from esd.cli.view import write_page

        write_page((source, drawn[0]), (target, drawn[1]), result, page)
        typer.launch(str(page.resolve()))


def _match_batch(
    batch: Path, folder: Path | None, model: Model, *, as_json: bool, force: bool, **options: Any
) -> None:
    import time

    from esd.common import InputError
    from esd.matching.batch import match_files, read_pairs_of_files

    start = time.perf_counter()
    folder = folder or Path()
    if options["scheduler"]:  # its workers may run in other folders
        batch, folder = batch.resolve(), folder.resolve()
    pairs = read_pairs_of_files(batch, folder=folder)
    for pair in pairs:
        free_path(pair.output, force=force)
    steps = len(pairs) + len({file for pair in pairs for file in (pair.source, pair.target)})
    maps, failed = [], 0
    with progress("matching", steps) as went:
        for done in match_files(pairs, model=model, on_step=lambda: went(1), **options):
            names = {key: str(getattr(done.pair, key)) for key in ("source", "target", "output")}
            maps.append({**names, **{k: v for k, v in asdict(done).items() if k != "pair"}})
            failed += done.failure is not None
            if not as_json and done.failure:
                typer.echo(f"{done.pair.output}\t{done.failure}")
    if as_json:
        seconds = time.perf_counter() - start
        typer.echo(json.dumps({"model": model.name, "maps": maps, "seconds": seconds}))
    else:
        tell(f"{len(pairs) - failed} of {len(pairs)} pairs matched")
    if failed:
        raise InputError(f"{failed} of {len(pairs)} pairs failed; the other maps are written.")
