"""The atlas of a population as one self-contained web page."""

from __future__ import annotations

from collections.abc import Sequence
from string import Template

import numpy as np
import numpy.typing as npt

from esd.common import FloatArray, InputError
from esd.mesh.mesh import Mesh
from esd.population.atlas import Atlas
from esd.population.shape_model import without_missing
from esd.viewing.page import Page, escaped, page_with, part
from esd.viewing.scene import PALETTE, Scene, of_unit_area, round_above, shape_arrays
from esd.viewing.upright import AXES, default_up

MODULES = ("data.js", "colours.js", "shape.js", "viewer.js", "report.js")
"""Of the page."""

_MODES = 8  # sliders at most; each mode takes as many bytes as the mean shape
_WIDTH, _HEIGHT, _MARGIN = 270, 150, 34  # of a chart, in pixels
_TICKS = 4


def report(atlas: Atlas, *, title: str = "Atlas", up: str | None = None) -> Page:
    """A page with the mean shape, sliders for its modes, a heat map of variation, and tables.

    Parameters
    ----------
    title
        Of the page.
    up
        The axis, one of `x`, `-x`, `y`, `-y`, `z` and `-z`, that points up; by default z where the
        mean is longest along z, otherwise y.

    Raises
    ------
    InputError
        If the axis is another.
    """
    shown = _scene(atlas, up)
    body = Template(part("report.html")).substitute(
        title=escaped(title),
        statistics=_statistics(atlas),
        curves=_curves(atlas),
        modes=_modes_table(atlas),
        shapes=_shapes_table(atlas),
    )
    return page_with(
        shown,
        title=title,
        style=part("viewer.css") + part("report.css"),
        modules=MODULES,
        body=body,
        start=part("start-report.js"),
    )


def _scene(atlas: Atlas, up: str | None) -> Scene:
    """The mean shape at unit area, the displacement of its vertices by each mode, and variation."""
    mean = without_missing(atlas.mean, atlas.faces)
    up = default_up(mean) if up is None else up
    if up not in AXES:
        raise InputError(f"`up` must be one of {', '.join(AXES)}; got '{up}'.")
    drawn = of_unit_area(mean)
    factor = _extent(drawn) / _extent(mean)
    count = min(_MODES, len(atlas.modes))
    deviations = np.sqrt(atlas.variances[:count])
    moves = np.nan_to_num(deviations[:, None, None] * atlas.modes[:count])
    # lengths as shares of the longest side of the mean's bounding box
    fields = {"deviation": atlas.model.deviation() / _extent(mean)}
    fields |= {
        f"size_{k + 1}": np.linalg.norm(move, axis=1) / _extent(mean)
        for k, move in enumerate(moves)
    }
    high = round_above(float(np.nanquantile(fields["deviation"], 0.99)))
    titles = ["Standard deviation", *(f"Displacement by mode {k + 1}" for k in range(count))]
    arrays: dict[str, npt.NDArray[np.generic]] = {
        **shape_arrays("source", drawn),
        **{f"mode_{k + 1}": (factor * move).astype("<f4") for k, move in enumerate(moves)},
        **{name: values.astype("<f4") for name, values in fields.items()},
    }
    shares = atlas.variances[:count] / max(atlas.model.total_variance, np.finfo(float).tiny)
    scores = atlas.scores[:, :count] / deviations
    meta = {
        **PALETTE,
        "up": up,
        "radius": float(np.linalg.norm(drawn.vertices, axis=1).max()),
        "explained": shares.tolist(),
        "fields": [
            {"name": name, "title": title, "low": 0.0, "high": high, "factor": 100.0}
            | {"unit": "% of the extent"}
            for name, title in zip(fields, titles, strict=True)
        ],
        "shapes": [
            {"name": name, "scores": row.round(3).tolist()}
            for name, row in zip(atlas.names, scores, strict=True)
        ],
    }
    return Scene(meta, arrays)


def _extent(mesh: Mesh) -> float:
    """Longest side of the bounding box."""
    return float(np.ptp(mesh.vertices, axis=0).max())


def _statistics(atlas: Atlas) -> str:
    share = atlas.model.explained()
    rows = [
        ("Shapes", f"{len(atlas.names)}"),
        ("Left out", f"{len(atlas.left_out)}"),
        ("Far from the mean", f"{int(atlas.is_outlier.sum())}"),
        ("Template", atlas.template),
        ("Vertices, faces", f"{len(atlas.mean):,}, {len(atlas.faces):,}"),
        ("Sizes", "kept" if atlas.model.keep_size else "removed"),
        ("Modes for 90 %", f"{int(np.searchsorted(share, 0.9)) + 1} of {len(share)}"),
    ]
    return "".join(f"<dt>{escaped(name)}</dt><dd>{escaped(value)}</dd>" for name, value in rows)


def _curves(atlas: Atlas) -> str:
    """Compactness, generalisation and specificity over the number of modes."""
    found = atlas.quality
    extent = _extent(without_missing(atlas.mean, atlas.faces))
    return "".join(
        _chart(title, text, 100 * values)
        for title, text, values in (
            ("Compactness", "variance explained, %", found.compactness),
            (
                "Generalisation",
                "what the modes of the others leave of a shape, % of the extent",
                found.generalisation / extent,
            ),
            (
                "Specificity",
                "random shapes from the most similar one, % of the extent",
                found.specificity / extent,
            ),
        )
    )


def _chart(title: str, text: str, values: FloatArray) -> str:
    """Values over 1, 2, … modes, as SVG."""
    high = round_above(float(values.max()))
    width, height = _WIDTH - _MARGIN - 8, _HEIGHT - _MARGIN
    across = _MARGIN + width * (np.arange(len(values)) + 0.5) / len(values)
    down = 8 + (height - 8) * (1 - values / high)
    points = " ".join(f"{x:.1f},{y:.1f}" for x, y in zip(across, down, strict=True))
    parts = []
    for tick in range(_TICKS + 1):
        y = 8 + (height - 8) * (1 - tick / _TICKS)
        parts += [
            f'<line x1="{_MARGIN}" x2="{_WIDTH - 8}" y1="{y:.1f}" y2="{y:.1f}"/>',
            f'<text x="{_MARGIN - 5}" y="{y + 3:.1f}" text-anchor="end">'
            f"{high * tick / _TICKS:.3g}</text>",
        ]
    step = max(1, len(values) // 6)
    parts += [
        f'<text x="{x:.1f}" y="{height + 15}" text-anchor="middle">{k + 1}</text>'
        for k, x in enumerate(across)
        if k % step == 0
    ]
    parts.append(
        f'<text x="{_MARGIN + width / 2}" y="{_HEIGHT - 4}" text-anchor="middle">modes</text>'
    )
    dots = "".join(
        f'<circle cx="{x:.1f}" cy="{y:.1f}" r="2.5"/>' for x, y in zip(across, down, strict=True)
    )
    return (
        f"<figure><figcaption>{title}<small>{text}</small></figcaption>"
        f'<svg viewBox="0 0 {_WIDTH} {_HEIGHT}" role="img" aria-label="{title} by number of modes">'
        f'{"".join(parts)}<polyline points="{points}"/>{dots}</svg></figure>'
    )


def _modes_table(atlas: Atlas) -> str:
    total = max(atlas.model.total_variance, np.finfo(float).tiny)
    extent = _extent(without_missing(atlas.mean, atlas.faces))
    rows = [
        (
            str(k + 1),
            f"{100 * variance / total:.1f}",
            f"{100 * explained:.1f}",
            f"{100 * np.sqrt(variance) / extent:.2f}",
        )
        for k, (variance, explained) in enumerate(
            zip(atlas.variances, atlas.model.explained(), strict=True)
        )
    ]
    head = ("mode", "variance, %", "up to here, %", "standard deviation, % of the extent")
    return _table(head, [("", row) for row in rows])


def _shapes_table(atlas: Atlas) -> str:
    """All shapes: those left out first, then those far from the mean."""
    place = {name: i for i, name in enumerate(atlas.names)}
    extent = _extent(without_missing(atlas.mean, atlas.faces))
    far = {name for name, is_far in zip(atlas.names, atlas.is_outlier, strict=True) if is_far}
    order = sorted(
        atlas.shapes, key=lambda each: (each.name in place, each.name not in far, each.name)
    )
    rows = []
    for each in order:
        i = place.get(each.name)
        known = not each.failure
        figures = (
            each.verdict or "–",
            f"{100 * each.distance:.3f}" if known else "–",
            f"{100 * each.supported:.0f}" if known else "–",
            f"{100 * each.covered:.0f}" if known else "–",
            str(each.inverted) if known else "–",
            "–" if i is None else f"{atlas.sizes[i]:.4g}",
            "–" if i is None else f"{100 * atlas.distance[i] / extent:.2f}",
        )
        button = f'<button type="button" data-shape="{i}">Show</button>' if i is not None else ""
        reason = escaped(atlas.left_out.get(each.name, ""))
        kind = "left-out" if i is None else "outlier" if each.name in far else ""
        cells = (escaped(each.name), escaped(each.subject), *figures, button or reason)
        rows.append((kind, cells))
    head = (
        "shape",
        "subject",
        "map",
        "to the surface, %",
        "supported, %",
        "covered, %",
        "inverted faces",
        "size",
        "from the mean, %",
        "",
    )
    return _table(head, rows)


def _table(head: Sequence[str], rows: Sequence[tuple[str, Sequence[str]]]) -> str:
    """A table of cells that are HTML; a row has a class."""
    cells = "".join(f"<th>{cell}</th>" for cell in head)
    lines = [f"<thead><tr>{cells}</tr></thead>"]
    for kind, row in rows:
        mark = f' class="{kind}"' if kind else ""
        lines.append(f"<tr{mark}>{''.join(f'<td>{cell}</td>' for cell in row)}</tr>")
    return f"<table>{''.join(lines)}</table>"
