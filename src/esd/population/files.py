"""What an atlas writes to its folder."""

from __future__ import annotations

import csv
import os
from collections.abc import Iterable, Sequence
from pathlib import Path

from esd.common import whole_file
from esd.mesh.io.meshes import write_mesh
from esd.population.atlas import Atlas
from esd.population.shape_model import save_shape_model, without_missing


def save_atlas(atlas: Atlas, folder: str | os.PathLike[str]) -> None:
    """Write the model, the mean shape and tables of an atlas to a folder.

    `model.npz`, see `esd.population.shape_model.save_shape_model`; `mean.ply`; `scores.csv`, a line
    for each shape of the statistics, lengths in the unit of the shapes; `modes.csv`, a line for
    each mode; `shapes.csv`, a line for each shape of the population.

    Raises
    ------
    InputError
        If a file cannot be written.
    """
    folder = Path(folder)
    save_shape_model(atlas.model, folder / "model.npz")
    write_mesh(without_missing(atlas.mean, atlas.faces), folder / "mean.ply")
    modes = range(1, len(atlas.modes) + 1)
    _write_table(
        folder / "scores.csv",
        ["name", "subject", "size", "distance", "outlier", *(f"mode_{k}" for k in modes)],
        (
            [name, subject, _number(size), _number(distance), int(outlier), *map(_number, scores)]
            for name, subject, size, distance, outlier, scores in zip(
                atlas.names,
                atlas.subjects,
                atlas.sizes,
                atlas.distance,
                atlas.is_outlier,
                atlas.scores,
                strict=True,
            )
        ),
    )
    share = atlas.variances / max(atlas.model.total_variance, 1e-300)
    _write_table(
        folder / "modes.csv",
        ["mode", "variance", "explained", "compactness", "generalisation", "specificity"],
        (
            [k, *map(_number, row)]
            for k, *row in zip(
                modes,
                atlas.variances,
                share,
                atlas.quality.compactness,
                atlas.quality.generalisation,
                atlas.quality.specificity,
                strict=True,
            )
        ),
    )
    _write_table(
        folder / "shapes.csv",
        [
            "name",
            "subject",
            "verdict",
            "expected_accuracy",
            "relative_distance",
            "supported",
            "covered",
            "inverted",
            "left_out",
        ],
        (
            [
                each.name,
                each.subject,
                each.verdict or "",
                "" if each.expected_accuracy is None else _number(each.expected_accuracy),
                _number(each.distance),
                _number(each.supported),
                _number(each.covered),
                each.inverted,
                atlas.left_out.get(each.name, ""),
            ]
            for each in atlas.shapes
        ),
    )


def _write_table(path: Path, head: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    with (
        whole_file(path) as temporary,
        temporary.open("w", newline="", encoding="utf-8") as file,
    ):
        writer = csv.writer(file)
        writer.writerow(head)
        writer.writerows(rows)


def _number(value: float) -> str:
    return f"{value:.9g}"
