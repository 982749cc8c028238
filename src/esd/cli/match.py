"""`esd match`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

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
    RefineOption,
    RejectOption,
    RepairOption,
    Scale,
    ScaleOption,
    SourceArgument,
    TargetArgument,
    candidate_names,
    check_coarse,
    check_threshold,
)
from esd.cli.output import about, destination, tell
from esd.cli.progress import progress
from esd.cli.shapes import landmark_pairs, read_shown

if TYPE_CHECKING:
    from esd.matching.confidence import Judgement


def match(
    source: SourceArgument,
    target: TargetArgument,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            metavar="MAP",
            help="Ends in .csv, .npy, .txt or .vts; by default SOURCE-TARGET.csv.",
        ),
    ] = None,
    model: ModelOption = "default",
    refine: RefineOption = None,
    landmarks: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="FILE [FILE]",
            help="Landmarks of SOURCE and of TARGET, paired by name (columns name,vertex or "
            "name,x,y,z), or one file of pairs of vertices (columns source,target).",
            show_default=False,
        ),
    ] = None,
    mirror: MirrorOption = Mirror.auto,
    scale: ScaleOption = Scale.auto,
    candidates: CandidatesOption = None,
    adapt: AdaptOption = False,
    reject: RejectOption = False,
    min_confidence: MinConfidenceOption = 0.0,
    one_to_one: OneToOneOption = False,
    coarse: CoarseOption = None,
    full: FullOption = False,
    view: Annotated[
        bool,
        typer.Option("--view", help="Also write a page that shows the map, and open it."),
    ] = False,
    repair: RepairOption = False,
    device: DeviceOption = "cpu",
    as_json: JsonOption = False,
    force: ForceOption = False,
) -> None:
    """Map each vertex of SOURCE to its vertex of TARGET.

    Defective meshes and point clouds are accepted, see esd doctor. The map is that of the files'
    vertices. It is chosen among several candidates; --json and --verbose say which.
    """
    import logging
    import time
    from dataclasses import asdict

    from esd.learning.model import load_model
    from esd.matching.correspondence import check_map_path, save_map
    from esd.matching.match import match as match_meshes
    from esd.matching.match import prepared
    from esd.spectral.cache import default_cache

    check_coarse(coarse, one_to_one=one_to_one, full=full)
    chosen_from = candidate_names(candidates, landmarks=bool(landmarks))
    start = time.perf_counter()
    inputs = [source, target, *(landmarks or [])]
    path = check_map_path(output or Path(f"{source.stem}-{target.stem}.csv"))
    destination(path, force=force, inputs=inputs)
    page = path.with_suffix(".html")
    if view:
        destination(page, force=force, inputs=inputs)
        drawn = read_shown(source), read_shown(target)
    loaded = load_model(model, device=device)
    if adapt:
        from esd.matching.adapt import check_adaptation  # with much that is slow to import

        check_adaptation(loaded)
    if reject:
        check_threshold(loaded)
    names, pairs = landmark_pairs(landmarks or [], source, target)
    cache, shapes = default_cache(), []
    with progress("matching"):
        for file in (source, target):
            with about(file):
                shapes.append(prepared(file, everything=repair, coarse=coarse, full=full))
        with about(f"{source}' and '{target}"):
            result = match_meshes(
                *shapes,
                model=loaded,
                refine=refine,
                one_to_one=one_to_one,
                candidates=chosen_from,
                landmarks=pairs,
                mirror=mirror.value,
                scale=scale.value,
                adapt=adapt,
                coarse=coarse,
                full=full,
                cache=cache,
            )
        if reject:
            result = result.rejecting(loaded.threshold())
        result = result.confident(min_confidence)
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
        "candidate": judged.candidate if judged else None,
        "candidate_costs": dict(judged.costs) if judged else {},
        "unmatched": judged.unmatched if judged else None,
        "overlap": asdict(judged.overlap) if judged and judged.overlap else None,
        "mirrored": judged.is_mirrored if judged else False,
        "landmarks": 0 if pairs is None else len(pairs),
        "contradicted_landmarks": [names[i] for i in judged.contradicted] if judged else [],
        "adaptation": asdict(judged.adaptation) if judged and judged.adaptation else None,
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
            _tell_judgement(judged, names)
    if judged and judged.costs:
        costs = ", ".join(f"{name} {value:.2f}" for name, value in sorted(judged.costs.items()))
        logging.getLogger(__name__).info(
            "The map is the candidate '%s'; costs, the least is best: %s.", judged.candidate, costs
        )
    if view:
        from esd.cli.view import write_page

        write_page((source, drawn[0]), (target, drawn[1]), result, page, model=loaded.name)
        typer.launch(str(page.resolve()))


def _tell_judgement(judged: Judgement, names: tuple[str, ...]) -> None:
    tell(
        f"{judged.verdict}: about {judged.expected_accuracy:.0%} within 5 % of the "
        f"diameter. {judged.advice}".rstrip()
    )
    if judged.adaptation:
        tell(judged.adaptation.in_a_line())
    if judged.is_mirrored:
        tell("The source was mirrored: its mirror image fits better.")
    for index in judged.contradicted:
        tell(f"Landmark '{names[index]}' was left out: the others contradict it.")
