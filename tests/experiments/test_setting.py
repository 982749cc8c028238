from dataclasses import replace

import pytest

from esd.experiments import setting
from esd.experiments.setting import fingerprint, shortened, trained
from esd.learning.presets import PRESETS


def test_other_data_are_trained_on_anew(made, monkeypatch):
    monkeypatch.setattr("esd.learning.train.train", None)
    training = setting.paper_training("hks", quick=True)
    other = replace(made, training=made.testing)
    assert fingerprint(made.training) != fingerprint(made.testing)
    with pytest.raises(TypeError):
        trained(other, "EHKS", training)


def test_short_trainings_end_at_the_same_learning_rate():
    whole = PRESETS["paper-hks"]
    short = shortened(whole, 100)
    assert short.steps == 100
    assert short.decay**short.steps == pytest.approx(whole.decay**whole.steps)
