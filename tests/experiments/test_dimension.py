import pytest

from esd.experiments import (
    dimension,
)

pytest.importorskip("torch", reason="training needs the extra `train`")


def drawn(figures, folder):
    for name, figure in figures.items():
        figure.savefig(folder / f"{name}.png")
        assert (folder / f"{name}.png").stat().st_size > 5000
    return set(figures)


def test_dimension_of_noise_is_that_of_its_neighbourhood(made, tmp_path):
    outcome = dimension.run(made)
    rows = {row[0]: row[1:] for row in outcome.report.tables[0].rows}
    assert rows["noise"][:2] == (5, 9)
    assert max(rows["HKS"]) < 10
    assert drawn(dimension.figures(outcome), tmp_path) == {"dimension"}
