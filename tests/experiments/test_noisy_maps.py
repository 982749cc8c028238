import numpy as np

from esd.experiments.noisy_maps import NoisyMaps, precision_recall, separation


def judged(confidence, present) -> NoisyMaps:
    values = np.array([confidence])
    return NoisyMaps(
        "cut", 0.1, "HKS", values, values, values, ("good",), values, np.array([present])
    )


def test_precision_and_recall_of_counterparts():
    maps = judged([0.9, 0.8, 0.4, 0.2, np.nan], [True, False, True, False, True])
    precision, recall = precision_recall(maps, np.array([0, 0.5, 0.85, 1]))
    np.testing.assert_allclose(precision, [0.5, 0.5, 1, 1])
    np.testing.assert_allclose(recall, [1, 0.5, 0.5, 0])
    assert separation(maps) == 0.75  # of four pairs one is the wrong way round
    assert separation(judged([0.5, 0.5], [True, False])) == 0.5
    assert np.isnan(separation(judged([0.5], [True])))
