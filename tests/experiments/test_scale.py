import numpy as np

from esd.experiments import scale


def test_unit_area_removes_the_scale(made, drawn):
    outcome = scale.run(made)
    same, far = scale.FACTORS.index(1.0), scale.FACTORS.index(2.0)
    for name, shares in outcome.shares.items():
        if "unit area" in name or name.startswith("GPS"):
            # rounding may turn a match or two of 384
            np.testing.assert_allclose(shares, shares[same], atol=0.6)
    assert outcome.shares["HKS, own size"][far] < 0.5 * outcome.shares["HKS, own size"][same]
    assert drawn(scale.figures(outcome)) == {"scale"}
