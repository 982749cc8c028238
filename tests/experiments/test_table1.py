from esd.experiments import counting, table1


def test_table1_counts_six_descriptors_and_goes_on(made, drawn, monkeypatch):
    outcome = table1.run(made)
    assert [m.name for m in outcome.matched] == ["GPS", "HKS", "WKS", "EGPS", "EHKS", "EWKS"]
    first = outcome.report.tables[0]
    assert first.rows[0][:2] == (outcome.pairs[0][0].name, outcome.pairs[0][1].name)
    assert first.rows[0][3] == outcome.matched[1].counts[0] > 0
    assert outcome.report.tables[1].rows[0][-1] == 706
    assert "in the paper, on Dyna, 19.78 times (1579 against 80 of 6890)" in "".join(
        outcome.report.findings
    )
    assert all({s.subject, t.subject} == {"s2", "s3"} for s, t in outcome.pairs)
    assert drawn(table1.figures(outcome)) == {"matches", "counts"}
    # again: nothing is trained or matched anew
    monkeypatch.setattr(counting, "_correct_on_target", None)
    monkeypatch.setattr("esd.learning.train.train", None)
    assert table1.run(made).report == outcome.report
