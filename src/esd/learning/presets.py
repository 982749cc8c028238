"""Named ways of training."""

from __future__ import annotations

from dataclasses import dataclass

from esd.common import InputError
from esd.descriptors.recipe import Recipe, single_recipe


@dataclass(frozen=True, slots=True)
class Training:
    """Everything that a training depends on, but the data and the seed.

    Parameters
    ----------
    recipe
        The descriptors.
    hidden
        Neurons of the hidden layers.
    outputs
        Dimension of the embedding.
    standardise
        Whether descriptors are standardised over the training shapes.
    margin
        C, in squared units of the embedding.
    soft_label
        Largest label of a pair that does not correspond.
    batch
        Pairs in a step, half of them corresponding.
    learning_rate
        Of Adam, at the first step.
    decay
        Factor on the learning rate after each step.
    steps
        Number of steps.
    """

    recipe: Recipe
    hidden: tuple[int, ...]
    outputs: int = 15
    standardise: bool = True
    margin: float = 5.0
    soft_label: float = 0.2
    batch: int = 512
    learning_rate: float = 0.015
    decay: float = 0.9999
    steps: int = 20_000


PRESETS = {
    "paper-hks": Training(single_recipe("hks"), hidden=(78, 32)),
    "paper-wks": Training(single_recipe("wks"), hidden=(78, 32)),
    "paper-gps": Training(single_recipe("gps"), hidden=(20, 18)),
}
"""The networks of the paper (sections 3.4 and 3.5), which leaves the number of steps open."""


def preset(name: str) -> Training:
    """The training of a name.

    Raises
    ------
    InputError
        If there is none.
    """
    if name not in PRESETS:
        raise InputError(f"There is no preset '{name}'; expected one of {', '.join(PRESETS)}.")
    return PRESETS[name]
