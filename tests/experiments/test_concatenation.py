from esd.experiments import concatenation


def test_concatenation_is_compared_with_its_parts(made, drawn):
    outcome = concatenation.run(made)
    assert [m.name for m in outcome.matched][3:] == ["GPS+HKS+WKS", "GPS+HKS+WKS, wide"]
    best = max(outcome.matched[:3], key=lambda m: m.counts.mean()).name
    assert outcome.report.tables[0].rows[3][7] == best
    assert drawn(concatenation.figures(outcome)) == {"counts"}
