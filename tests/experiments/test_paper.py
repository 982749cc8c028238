import numpy as np

from esd.experiments.paper import TABLE1, TABLE1_POINTS, TABLE2


def test_embeddings_have_19_78_times_the_matches_of_gps_at_most():
    """The factors that the paper's text names, from its own tables."""
    counts = {name: TABLE1.header.index(name) for name in ("GPS", "EGPS")}
    factors = [row[counts["EGPS"]] / row[counts["GPS"]] for row in TABLE1.rows if row[2]]
    assert len(factors) == 5  # GPS matches nothing of the first pair
    assert all(factor > 1 for factor in factors)
    assert all(max(row[2:]) < TABLE1_POINTS for row in TABLE1.rows)


def test_ehks_has_five_times_the_share_of_the_best_other_on_the_most_different_subjects():
    last = dict(zip(TABLE2.header, TABLE2.rows[-1], strict=True))
    others = [last[f"{name} %"] for name in ("OSD", "GCNN", "ACNN")]
    np.testing.assert_allclose(last["EHKS %"] / max(others), 5.62, atol=0.005)
    deviations = np.array([row[3::2] for row in TABLE2.rows], dtype=float)
    assert (deviations.argmin(axis=1) == 4).all()  # of EHKS, in all four groups
