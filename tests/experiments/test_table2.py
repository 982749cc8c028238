from dataclasses import replace

import numpy as np
import pytest

from esd.common import InputError
from esd.experiments import comparison, costs, table2
from esd.mesh.geometry import surface_area


def test_table2_compares_methods_on_ever_more_different_subjects(compared, drawn, monkeypatch):
    outcome = table2.run(compared)
    assert list(outcome.models) == ["HKS", *table2.LEARNED]
    assert len(outcome.groups) == 2
    same, other = outcome.groups
    # the smaller of the two subjects is the source of all pairs
    area = {s.subject: surface_area(s.mesh()) for s in compared.testing.shapes}
    smallest = min(area, key=area.get)
    assert same.subjects == f"{smallest}\\{smallest}"
    assert {s.subject for s, _ in other.pairs} == {smallest}
    assert {t.subject for _, t in other.pairs} == {"s2", "s3"} - {smallest}
    assert len(same.pairs) == 2  # all there are
    assert len(other.pairs) == 4
    assert 0 < same.disparity.mean() < other.disparity.mean()
    for group in outcome.groups:
        for method in outcome.models:
            assert [len(errors) for errors in group.errors[method]] == [38] * len(group.pairs)
            curve = group.curve(method)
            assert (np.diff(curve) >= 0).all()
            at_5_percent = curve[np.searchsorted(comparison.RADII, 0.05)]
            assert 100 * at_5_percent == pytest.approx(group.accuracies(method).mean())
    # trained on one subject, validated on the other, as HKS is not
    shapes = {tuple(model.card.get("shapes", ())) for model in outcome.models.values()}
    assert len(shapes) == 2
    tables = {table.name: table for table in outcome.report.tables}
    assert tables["paper_table2"].rows[3][-2:] == (10.12, 0.10)
    assert [row[0] for row in tables["costs"].rows] == list(outcome.models)
    assert all(row[1] > 0 for row in tables["costs"].rows)
    trained_by_steps = [name for name in outcome.models if name not in ("HKS", "OSD")]
    assert list(dict.fromkeys(row[0] for row in tables["training"].rows)) == trained_by_steps
    assert "mirrored" not in tables
    text = " ".join(outcome.report.findings)
    assert "nothing is excluded" in text
    assert "EHKS has 5.62 times the share of OSD, the best of the others" in text
    assert drawn(table2.figures(outcome)) == {"curves", "matches", "training"}
    # again: nothing is trained, matched or measured anew
    monkeypatch.setattr(comparison, "_errors", None)
    monkeypatch.setattr(costs, "embedding_cost", None)
    monkeypatch.setattr("esd.learning.train.train", None)
    assert table2.run(compared).report == outcome.report


def test_table2_leaves_out_parts_and_takes_mirrored_matches(compared):
    parts = np.where(np.arange(384) < 96, "left hand", "torso")

    def known(collection):
        return replace(
            collection,
            shapes=tuple(
                replace(s, symmetric=lambda: np.roll(np.arange(384), 192), parts=lambda: parts)
                for s in collection.shapes
            ),
        )

    outcome = table2.run(replace(compared, testing=known(compared.testing)))
    assert "(25% of the points) are excluded" in " ".join(outcome.report.findings)
    assert outcome.report.tables[1].name == "mirrored"
    for group in outcome.groups:
        for method in outcome.models:
            assert not group.shown[method][:96].any()
            for direct, nearer in zip(group.errors[method], group.mirrored[method], strict=True):
                assert len(direct) == 29  # a tenth of the 288 that are left
                assert (nearer <= direct).all()
    assert any((g.mirrored["HKS"][0] < g.errors["HKS"][0]).any() for g in outcome.groups)


def test_table2_needs_subjects_that_correspond(made):
    with pytest.raises(InputError, match="two subjects or more to train on and to test on; got 1"):
        table2.run(replace(made, training=made.training.of_subjects(["s0"])))
    shapes = made.testing.shapes
    foreign = tuple(replace(s, template="x") if s.subject == "s3" else s for s in shapes)
    with pytest.raises(InputError, match=r"No shapes of 's.' and 's.' correspond"):
        comparison.drawn_groups(replace(made, testing=replace(made.testing, shapes=foreign)))
