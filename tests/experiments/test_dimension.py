from esd.experiments import dimension


def test_dimension_of_noise_is_that_of_its_neighbourhood(made, drawn):
    outcome = dimension.run(made)
    rows = {row[0]: row[1:] for row in outcome.report.tables[0].rows}
    assert rows["noise"][:2] == (5, 9)
    assert max(rows["HKS"]) < 10
    assert drawn(dimension.figures(outcome)) == {"dimension"}
