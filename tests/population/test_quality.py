import numpy as np
import pytest

from esd.population.quality import model_quality, outliers


def test_figures_of_a_population_in_three_dimensions():
    generator = np.random.default_rng(0)
    deviations = np.array([3.0, 2.0, 1.0])
    scores = generator.normal(size=(400, 3)) * deviations
    found = model_quality(scores - scores.mean(axis=0), count=3)
    assert found.compactness == pytest.approx([9 / 14, 13 / 14, 1.0], abs=0.03)
    # what one mode leaves is the root of χ² with the two other variances; three leave nothing
    expected = np.sqrt(((generator.normal(size=(100_000, 2)) * [2.0, 1.0]) ** 2).sum(axis=1)).mean()
    assert found.generalisation[0] == pytest.approx(expected, rel=0.05)
    assert found.generalisation[2] == pytest.approx(0.0, abs=1e-6)  # root of rounding
    assert (np.diff(found.generalisation) < 0).all()
    # one more mode makes random shapes less like the nearest of those there are
    assert found.specificity.shape == (3,)
    assert (found.specificity > 0).all()


def test_a_model_of_few_shapes_is_asked_for_no_more_modes_than_there_are():
    scores = np.array([[1.0, 0.0], [-1.0, 0.5], [0.0, -0.5]])
    found = model_quality(scores, count=2)
    # two others span a line: the second mode adds nothing
    assert found.generalisation[0] == pytest.approx(found.generalisation[1])


def test_one_far_from_the_mean_is_an_outlier():
    distance = np.array([1.0, 1.1, 0.9, 1.2, 1.0, 2.0])
    assert outliers(distance).tolist() == [False] * 5 + [True]
    assert not outliers(np.ones(5)).any()
