"""The same shapes at other sizes (future work of the paper)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from matplotlib.figure import Figure

from esd.common import FloatArray
from esd.datasets.collection import Shape
from esd.experiments.counting import correct_matches, drawn_pairs
from esd.experiments.report import Report, Table
from esd.experiments.setting import KINDS, Setting, fingerprint, paper_training, trained
from esd.learning.model import Model, raw_model
from esd.mesh.mesh import Mesh
from esd.viewing.figures import blank_figure

FACTORS = (0.5, 0.8, 1.0, 1.25, 2.0)
"""Sizes of the target, in units of its own."""

_PAIRS = 10
_QUICK_PAIRS = 4


@dataclass(frozen=True, slots=True)
class ScaleOutcome:
    """Share of correct matches by method, for each of the factors."""

    shares: Mapping[str, tuple[float, ...]]
    report: Report


def run(setting: Setting) -> ScaleOutcome:
    """Match shapes to targets of other sizes, with descriptors of the raw and the unit-area shape.

    Embeddings are trained on shapes of their own size.
    """
    models: dict[str, Model] = {}
    for kind in KINDS:
        for what, unit_area in (("own size", False), ("unit area", True)):
            raw = raw_model(kind)
            recipe = replace(raw.recipe, unit_area=unit_area)
            training = replace(paper_training(kind, quick=setting.quick), recipe=recipe)
            embedding = f"E{kind.upper()}" if unit_area else f"E{kind.upper()}-own-size"
            models[f"{kind.upper()}, {what}"] = replace(raw, recipe=recipe)
            models[f"E{kind.upper()}, {what}"] = trained(setting, embedding, training)
    pairs = drawn_pairs(setting)[: _QUICK_PAIRS if setting.quick else _PAIRS]
    data = fingerprint(setting.testing)
    found: dict[str, list[FloatArray]] = {name: [] for name in models}
    for factor in FACTORS:
        resized = [(source, _scaled(target, factor)) for source, target in pairs]
        for method in correct_matches(setting, models, resized, data=data):
            found[method.name].append(method.shares)
    shares = {
        name: tuple(100 * float(share.mean()) for share in sized) for name, sized in found.items()
    }
    table = Table(
        "scale",
        f"Share of correct matches in percent, mean over {len(pairs)} pairs, by size of the target",
        ("descriptor", *(f"x {factor:g}" for factor in FACTORS)),
        tuple((name, *row) for name, row in shares.items()),
    )
    finding = (
        "By the paper, its formulation depends on the scale of the model. GPS has no units; HKS "
        "and WKS have those of 1 / area, and are free of them for the shape of unit area."
    )
    return ScaleOutcome(shares, Report("Shapes at other sizes", (finding,), (table,)))


def _scaled(shape: Shape, factor: float) -> Shape:
    def mesh() -> Mesh:
        original = shape.mesh()
        return Mesh(factor * original.vertices, original.faces)

    return replace(shape, name=f"{shape.name} x {factor:g}", mesh=mesh)


def figures(outcome: ScaleOutcome) -> dict[str, Figure]:
    """Share of correct matches by size of the target."""
    figure = blank_figure(9, 3.2)
    panels = figure.subplots(1, len(KINDS), sharey=True)
    for axes, kind in zip(panels, map(str.upper, KINDS), strict=True):
        for name, shares in outcome.shares.items():
            if name.split(",")[0] in (kind, f"E{kind}"):
                style = "x--" if "unit" in name else "o-"
                colour = "C1" if name.startswith("E") else "C0"
                axes.semilogx(FACTORS, shares, style, color=colour, label=name)
        axes.set_xticks(FACTORS, [f"{factor:g}" for factor in FACTORS], minor=False)
        axes.minorticks_off()
        axes.set_xlabel("size of the target")
        axes.legend(fontsize=7, handlelength=3.5)
    panels[0].set_ylabel("correct matches, %")
    return {"scale": figure}
