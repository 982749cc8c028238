"""Whether GPS, HKS and WKS side by side are better than each alone (the paper's conclusion)."""

from __future__ import annotations

from dataclasses import dataclass, replace

from matplotlib.figure import Figure

from esd.descriptors.recipe import Recipe
from esd.experiments.counting import CorrectMatches, correct_matches, drawn_pairs, summary
from esd.experiments.pictures import counts_figure
from esd.experiments.report import Report
from esd.experiments.setting import KINDS, Setting, fingerprint, paper_training, trained

CONCATENATED = "GPS+HKS+WKS"


@dataclass(frozen=True, slots=True)
class ConcatenationOutcome:
    """Matches by the three embeddings, and by that of all descriptors together."""

    matched: tuple[CorrectMatches, ...]
    report: Report


def run(setting: Setting) -> ConcatenationOutcome:
    """Train each embedding and that of the concatenated descriptors, count correct matches.

    The concatenation gets the network of HKS, and once the same of twice the width.
    """
    alone = {kind: paper_training(kind, quick=setting.quick) for kind in KINDS}
    recipe = Recipe(tuple(part for kind in KINDS for part in alone[kind].recipe.descriptors))
    together = replace(alone["hks"], recipe=recipe)
    wide = replace(together, hidden=tuple(2 * width for width in together.hidden))
    trainings = {f"E{kind.upper()}": training for kind, training in alone.items()}
    trainings |= {CONCATENATED: together, f"{CONCATENATED}, wide": wide}
    models = {name: trained(setting, name, training) for name, training in trainings.items()}
    pairs = drawn_pairs(setting)
    matched = correct_matches(setting, models, pairs, data=fingerprint(setting.testing))
    best = max(matched[: len(KINDS)], key=lambda method: method.counts.mean())
    table = summary(
        "concatenation",
        matched,
        compared=dict.fromkeys((CONCATENATED, f"{CONCATENATED}, wide"), best.name),
    )
    gain = matched[len(KINDS)].counts.mean() / best.counts.mean()
    finding = (
        f"The embedding of GPS, HKS and WKS together has {gain:.2f} times as many correct matches "
        f"as the best of the three alone, {best.name}. The paper observed no gain, without figures."
    )
    return ConcatenationOutcome(matched, Report("Concatenated descriptors", (finding,), (table,)))


def figures(outcome: ConcatenationOutcome) -> dict[str, Figure]:
    """Correct matches and covered area by each embedding."""
    return {"counts": counts_figure(outcome.matched)}
