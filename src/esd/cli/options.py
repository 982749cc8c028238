"""Arguments and options that several commands share."""

from __future__ import annotations

from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from esd.learning.model import Model
    from esd.parallel import Workers

ForceOption = Annotated[bool, typer.Option("--force", "-f", help="Replace a file that exists.")]
SourceArgument = Annotated[
    Path, typer.Argument(metavar="SOURCE", help="Mesh whose vertices are mapped.")
]
TargetArgument = Annotated[
    Path, typer.Argument(metavar="TARGET", help="Mesh that they are mapped to.")
]
MapArgument = Annotated[
    Path, typer.Argument(metavar="MAP", help="The map, as `esd match` writes it.")
]
TruthOption = Annotated[
    Path | None, typer.Option("--truth", metavar="MAP", help="The true map, to show the error.")
]
PointsOption = Annotated[
    tuple[Path, Path] | None,
    typer.Option(
        "--points",
        metavar="SOURCE.vts TARGET.vts",
        help="Instead: the vertices of both shapes at the same points, one a line, from 1.",
    ),
]
DatasetArgument = Annotated[
    str,
    typer.Argument(
        metavar="DATASET",
        help="A folder of meshes: with corres/, of one connectivity, or, for training, of any; an "
        "HDF5 file of Dyna or of esd precompute; or 'bodies'.",
    ),
]
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
        "--model", "-m", metavar="MODEL", help="A model folder, or {models}, or {descriptors}."
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
MinConfidenceOption = Annotated[
    float,
    typer.Option(
        "--min-confidence", min=0, max=1, help="Drop matches of less confidence, from 0 to 1."
    ),
]
PatienceOption = Annotated[
    float,
    typer.Option(
        metavar="SECONDS",
        min=0.1,
        help="With --scheduler: how long to wait for it, and for its workers while it has none.",
    ),
]
DeviceOption = Annotated[
    str,
    typer.Option(
        metavar="[cpu|cuda|auto]", help="Where embeddings, and the nearest of them, are computed."
    ),
]
OneToOneOption = Annotated[
    bool,
    typer.Option("--one-to-one", help="Match no target vertex twice; some source ones not."),
]
CoarseOption = Annotated[
    int | None,
    typer.Option(
        metavar="N",
        min=300,
        help="Match remeshed copies of about N vertices and upsample the map to all; 10000 by "
        "default where a mesh has more than twenty thousand.",
        show_default=False,
    ),
]
FullOption = Annotated[
    bool,
    typer.Option(
        "--full",
        help="Match the meshes as they are: no remeshed copies of those with more than fifty "
        "thousand vertices, no subdivided ones of those with fewer than two thousand.",
    ),
]
RepairOption = Annotated[
    bool,
    typer.Option("--repair", help="Repair all that esd doctor would, not the harmless alone."),
]
AdaptOption = Annotated[
    bool,
    typer.Option(
        "--adapt",
        help="Let MODEL learn on the pair first, without correspondences; kept if the map gets "
        "better. Takes some seconds more and needs the extra `train`.",
    ),
]
CandidatesOption = Annotated[
    str | None,
    typer.Option(
        metavar="NAMES",
        help="Choose the map only among these, with commas between: embedding, descriptors, "
        "extrinsic, extrinsic+embedding, extrinsic+descriptors, registered, part; with landmarks "
        "also landmarks+embedding, landmarks+descriptors, landmarks+extrinsic.",
        show_default=False,
    ),
]


class Mirror(str, Enum):
    """What `--mirror` takes."""

    auto = "auto"
    yes = "yes"
    no = "no"


MirrorOption = Annotated[
    Mirror,
    typer.Option(
        help="Mirror SOURCE first, as for a left and a right hand; auto: where that fits better."
    ),
]


class Scale(str, Enum):
    """What `--scale` takes."""

    auto = "auto"
    same = "same"
    free = "free"


ScaleOption = Annotated[
    Scale,
    typer.Option(
        help="Where parts are missing: whether both shapes have one unit of length (same), or that "
        "is not known (free); auto: they have unless the map fits badly."
    ),
]
JsonOption = Annotated[bool, typer.Option("--json", help="Print a summary as JSON.")]


def candidate_names(text: str | None, *, landmarks: bool = False) -> tuple[str, ...] | None:
    """The names in the text of `--candidates`; wrong usage if one is unknown."""
    from esd.common import InputError
    from esd.matching.choice import check_candidates

    if text is None:
        return None
    try:
        return check_candidates(
            [name.strip() for name in text.split(",") if name.strip()], landmarks=landmarks
        )
    except InputError as error:
        raise typer.BadParameter(str(error), param_hint="--candidates") from error


def check_coarse(coarse: int | None, *, one_to_one: bool, full: bool) -> None:
    """Wrong usage if a map by way of coarse copies is to be one-to-one, or full."""
    if one_to_one and coarse is not None:
        raise typer.BadParameter("Give --one-to-one or --coarse, not both.")
    if full and coarse is not None:
        raise typer.BadParameter("Give --full or --coarse, not both.")


def check_threshold(model: Model) -> None:
    """Raise an `InputError` if --reject can do nothing with a model."""
    from esd.common import InputError

    if model.margin is None:
        raise InputError(
            f"--reject needs a model that was trained with a margin, which '{model.name}' was not; "
            "drop matches by their confidence instead: --min-confidence 0.5."
        )


def workers_of(processes: int | None, scheduler: str | None, patience: float = 60.0) -> Workers:
    """What --workers, --scheduler and --patience say; wrong usage if they exclude each other."""
    from esd.parallel import Workers

    if processes is not None and scheduler is not None:
        raise typer.BadParameter("Give --workers or --scheduler, not both.")
    return Workers(processes, scheduler, patience)
