from esd.experiments import architecture


def test_architecture_trains_every_network_of_the_grid(made, drawn, monkeypatch):
    assert len(architecture.grid("hks", depth=2, step=2)) == 946
    for kind, chosen in architecture.CHOSEN.items():
        assert chosen in architecture.grid(kind, depth=2, step=2)
    outcome = architecture.run(made)
    trials = {(t.kind, t.hidden, t.seed): t for t in outcome.trials}
    assert len(trials) == len(outcome.trials)
    for kind in ("gps", "hks", "wks"):
        for depth, step in ((1, 16), (2, 16), (3, 32)):
            for hidden in architecture.grid(kind, depth=depth, step=2 if kind == "gps" else step):
                assert (kind, hidden, 0) in trials
        of_depth = [t for t in outcome.trials if (t.kind, len(t.hidden), t.seed) == (kind, 2, 0)]
        lowest = architecture.best(outcome.trials, kind, depth=2)
        assert lowest.testing.loss_mean == min(t.testing.loss_mean for t in of_depth)
    assert drawn(architecture.figures(outcome)) == {"architecture", "depth"}
    monkeypatch.setattr("esd.learning.architecture.train_many", None)
    assert architecture.run(made).trials == outcome.trials
