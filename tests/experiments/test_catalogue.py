from importlib import import_module

import pytest

from esd.experiments.catalogue import EXPERIMENTS


@pytest.mark.parametrize("name", EXPERIMENTS)
def test_each_experiment_is_a_module_that_runs_and_draws(name):
    module = import_module(f"esd.experiments.{name}")
    assert callable(module.run)
    assert callable(module.figures)
