import pytest

from esd.experiments import (
    concatenation,
)

pytest.importorskip("torch", reason="training needs the extra `train`")


def drawn(figures, folder):
    for name, figure in figures.items():
        figure.savefig(folder / f"{name}.png")
        assert (folder / f"{name}.png").stat().st_size > 5000
    return set(figures)


def test_concatenation_is_compared_with_its_parts(made, tmp_path):
    outcome = concatenation.run(made)
    assert [m.name for m in outcome.matched][3:] == ["GPS+HKS+WKS", "GPS+HKS+WKS, wide"]
    best = max(outcome.matched[:3], key=lambda m: m.counts.mean()).name
    assert outcome.report.tables[0].rows[3][7] == best
    assert drawn(concatenation.figures(outcome), tmp_path) == {"counts"}
