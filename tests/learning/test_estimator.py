import numpy as np
import pytest
from sklearn.neighbors import KNeighborsClassifier
from sklearn.pipeline import make_pipeline
from sklearn.utils.estimator_checks import parametrize_with_checks

from esd.learning.estimator import SpectralEmbedding, _pairs


@parametrize_with_checks([SpectralEmbedding(n_components=3, hidden=(8,), batch=32, steps=5)])
def test_scikit_learn_accepts_it(estimator, check):
    check(estimator)


def test_rows_of_one_point_come_near_each_other():
    """Points differ in two columns; a third, a thousand times larger, tells nothing."""
    generator = np.random.default_rng(0)
    point = np.repeat(np.arange(40), 6)
    place = generator.standard_normal((40, 2))
    noise = 1000 * generator.standard_normal((len(point), 1))
    rows = np.concatenate(
        [place[point] + 0.01 * generator.standard_normal((240, 2)), noise], axis=1
    )
    training = np.arange(240) % 6 < 4
    nearest = KNeighborsClassifier(1)
    raw = nearest.fit(rows[training], point[training]).score(rows[~training], point[~training])
    embedding = SpectralEmbedding(5, hidden=(32,), steps=800, random_state=0)
    pipeline = make_pipeline(embedding, nearest).fit(rows[training], point[training])
    assert raw < 0.2
    assert pipeline.score(rows[~training], point[~training]) > 0.7
    assert embedding.get_feature_names_out().tolist()[0] == "spectralembedding0"


def test_pairs_are_of_one_point_and_of_two():
    label = np.array([2, 0, 1, 0, 2, 2, 1])
    source, target, truth = _pairs(label, 100, 0.2, np.random.RandomState(0))
    np.testing.assert_array_equal(label[source] == label[target], np.arange(100) < 50)
    assert set(truth[:50]) == {1.0}
    assert 0 <= truth[50:].min() < truth[50:].max() <= 0.2


def test_one_point_teaches_nothing():
    with pytest.raises(ValueError, match="two points or more; got 1 class"):
        SpectralEmbedding(steps=1).fit(np.eye(3), np.zeros(3))
