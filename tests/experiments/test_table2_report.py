import numpy as np
import pytest

from esd.experiments import table2_report
from esd.learning.model import raw_model


def test_a_deviation_is_relative_and_of_a_sample():
    assert table2_report._deviation(np.array([1.0, 3.0])) == pytest.approx(np.sqrt(2) / 2)
    assert table2_report._deviation(np.zeros(3)) is None


def test_models_without_a_training_have_no_curve():
    assert table2_report.training_curve(raw_model("hks")) == ()


def test_pairs_and_curves_have_a_line_for_each_pair_and_radius(compared):
    from esd.experiments import table2

    outcome = table2.run(compared)
    tables = {table.name: table for table in outcome.report.tables}
    pairs = [pair for group in outcome.groups for pair in group.pairs]
    assert [row[1:3] for row in tables["pairs"].rows] == [(s.name, t.name) for s, t in pairs]
    assert all(len(row) == len(tables["pairs"].header) for row in tables["pairs"].rows)
    radii = len(table2_report.RADII)
    assert len(tables["curves"].rows) == radii * len(outcome.groups)
    # the last column of a group's last radius: what the figure ends with
    assert tables["curves"].rows[radii - 1][-1] == pytest.approx(
        100 * outcome.groups[0].curve(list(outcome.models)[-1])[-1]
    )
