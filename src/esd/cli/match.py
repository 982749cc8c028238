"""`esd match`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from esd.cli.output import ForceOption, free_path, tell

ModelOption = Annotated[
    str,
    typer.Option(
        "--model", "-m", metavar="MODEL", help="A model folder, a bundled name, or hks, wks, gps."
    ),
]


def match(
    source: Annotated[Path, typer.Argument(help="Mesh whose vertices are mapped.")],
    target: Annotated[Path, typer.Argument(help="Mesh that they are mapped to.")],
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
    refine: Annotated[
        bool | None,
        typer.Option(
            "--refine/--no-refine",
            help="Refine by ZoomOut; by default if MODEL tells left from right.",
            show_default=False,
        ),
    ] = None,
    reject: Annotated[
        bool, typer.Option("--reject", help="Drop matches beyond the model's threshold, C / 2.")
    ] = False,
    view: Annotated[
        bool,
        typer.Option("--view", help="Also write a page that shows the map, and open it."),
    ] = False,
    repair: Annotated[
        bool,
        typer.Option("--repair", help="Repair all that esd doctor would, not the harmless alone."),
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print a summary as JSON.")] = False,
    force: ForceOption = False,
) -> None:
    """Map each vertex of SOURCE to its vertex of TARGET.

    Meshes or points, broken ones as well: see esd doctor. The map is that of the files' vertices.
    """
    import time

    import numpy as np

    from esd.learning.model import load_model
    from esd.matching.correspondence import check_map_path, save_map
    from esd.matching.match import match as match_meshes
    from esd.mesh.doctor import repair as repaired

    start = time.perf_counter()
    path = free_path(
        check_map_path(output or Path(f"{source.stem}-{target.stem}.csv")), force=force
    )
    page = path.with_suffix(".html")
    if view:
        free_path(page, force=force)
    loaded = load_model(model)
    shapes = repaired(source, everything=repair), repaired(target, everything=repair)
    result = match_meshes(*shapes, model=loaded, refine=refine)
    if reject:
        result = result.rejecting(loaded.threshold())
    save_map(result, path)
    matched, judged = result.is_matched(), result.judgement
    targets = np.unique(result.target_index[matched])
    summary = {
        "model": loaded.name,
        "source_vertices": len(shapes[0].vertex_index),
        "target_vertices": len(shapes[1].vertex_index),
        "matched": int(matched.sum()),
        "coverage": len(targets) / len(shapes[1].vertex_index),
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
        from esd.mesh.mesh import as_mesh

        write_page((source, as_mesh(source)), (target, as_mesh(target)), result, page)
        typer.launch(str(page.resolve()))
