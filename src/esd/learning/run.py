"""What changes during a training, kept in checkpoints, and the weights that validate best."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Generic, TypeVar

import torch

from esd.learning.optimise import load_checkpoint, save_checkpoint

_PATIENCE = 10  # validations without improvement after which training stops
_PROGRESS = ("step", "best_loss", "best_step", "curve")  # what a checkpoint keeps beside tensors

N = TypeVar("N", bound=torch.nn.Module)


@dataclass(slots=True, eq=False)
class Run(Generic[N]):
    """All that changes during a training, and that a checkpoint keeps."""

    network: N
    optimiser: torch.optim.Adam
    step: int
    best_loss: float
    best_step: int
    best_weights: list[torch.Tensor]
    curve: list[tuple[int, float, float | None]]

    def resume(self, checkpoint: Path, *, identity: str) -> None:
        """Set all to what a checkpoint holds.

        Raises
        ------
        InputError
            See `esd.learning.optimise.load_checkpoint`.
        """
        state, tensors = load_checkpoint(
            checkpoint, self.network, self.optimiser, identity=identity
        )
        self.best_weights = [tensors[f"best {i}"] for i in range(len(self.best_weights))]
        for name in _PROGRESS:
            setattr(self, name, state[name])

    def save(self, checkpoint: Path, *, identity: str) -> None:
        """Write a checkpoint for `resume`."""
        save_checkpoint(
            checkpoint,
            self.network,
            self.optimiser,
            identity=identity,
            state={name: getattr(self, name) for name in _PROGRESS},
            tensors={f"best {i}": weight for i, weight in enumerate(self.best_weights)},
        )

    def note(self, loss: float) -> None:
        """Note the weights if their loss on the validation pairs is the best so far."""
        if loss < self.best_loss:
            self.best_loss, self.best_step = loss, self.step
            self.best_weights = weights_of(self.network)

    def is_exhausted(self, validate_every: int) -> bool:
        """Whether the loss has not fallen at ten validations."""
        return self.step - self.best_step >= _PATIENCE * validate_every


def first_run(network: N, optimiser: torch.optim.Adam) -> Run[N]:
    """The state before the first step."""
    return Run(network, optimiser, 0, float("inf"), 0, weights_of(network), [])


def weights_of(network: torch.nn.Module) -> list[torch.Tensor]:
    """Copies of the weights, in the order of the network's parameters."""
    return [parameter.detach().clone() for parameter in network.parameters()]
