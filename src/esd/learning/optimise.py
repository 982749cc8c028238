"""The step of a training, and the checkpoints from which an interrupted training resumes."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save

from esd.common import InputError, whole_file


def descend(
    optimiser: torch.optim.Optimizer,
    loss: torch.Tensor,
    *,
    rate: float,
    largest_norm: float | None = None,
) -> None:
    """One step of an optimiser down the gradient of a loss, at a learning rate.

    Parameters
    ----------
    largest_norm
        To which the gradient is shortened; one that is not finite is then not followed at all.
    """
    optimiser.param_groups[0]["lr"] = rate
    optimiser.zero_grad()
    loss.backward()
    if largest_norm is not None:
        weights = optimiser.param_groups[0]["params"]
        if not torch.nn.utils.clip_grad_norm_(weights, largest_norm).isfinite():
            return
    optimiser.step()


def adam_with_moments(
    network: torch.nn.Module, *, rate: float, weight_decay: float = 0.0
) -> torch.optim.Adam:
    """Adam for a network, whose moments exist before the first step, as checkpoints hold them.

    With weight decay, that of AdamW, apart from the gradient.
    """
    optimiser: torch.optim.Adam = (
        torch.optim.AdamW(network.parameters(), lr=rate, weight_decay=weight_decay)
        if weight_decay
        else torch.optim.Adam(network.parameters(), lr=rate)
    )
    for parameter in network.parameters():
        optimiser.state[parameter] = {
            "step": torch.tensor(0.0),
            "exp_avg": torch.zeros_like(parameter),
            "exp_avg_sq": torch.zeros_like(parameter),
        }
    return optimiser


def save_checkpoint(
    path: Path,
    network: torch.nn.Module,
    optimiser: torch.optim.Adam,
    *,
    identity: str,
    state: Mapping[str, Any],
    tensors: Mapping[str, torch.Tensor],
) -> None:
    """Write a checkpoint whole.

    Parameters
    ----------
    identity
        Key of all that the training depends on.
    state, tensors
        What the training keeps beside its weights and their moments: plain data, and tensors whose
        names do not begin with a digit.
    """
    held = dict(tensors)
    for i, parameter in enumerate(network.parameters()):
        moments = optimiser.state[parameter]
        held |= {
            f"{i}.weight": parameter.detach(),
            f"{i}.updates": moments["step"],
            f"{i}.first_moment": moments["exp_avg"],
            f"{i}.second_moment": moments["exp_avg_sq"],
        }
    with whole_file(path) as temporary:
        temporary.write_bytes(save(held, {"identity": identity, "state": json.dumps(dict(state))}))


def load_checkpoint(
    path: Path, network: torch.nn.Module, optimiser: torch.optim.Adam, *, identity: str
) -> tuple[Mapping[str, Any], Mapping[str, torch.Tensor]]:
    """State and tensors of `save_checkpoint`; weights and moments are set to those it holds.

    Raises
    ------
    InputError
        If the file is damaged, or of a training of another identity.
    """
    try:
        with safe_open(path, framework="pt") as file:
            metadata = file.metadata() or {}
            held = {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118
    except (SafetensorError, OSError) as error:
        raise InputError(f"The checkpoint '{path}' is damaged; remove it: {error}.") from error
    if metadata.get("identity") != identity:
        raise InputError(
            f"The checkpoint '{path}' belongs to another training (other data, preset or seed). "
            "Choose another output, or remove it."
        )
    with torch.no_grad():
        for i, parameter in enumerate(network.parameters()):
            parameter.copy_(held[f"{i}.weight"])
            optimiser.state[parameter] = {
                "step": held[f"{i}.updates"],
                "exp_avg": held[f"{i}.first_moment"].to(parameter.device),
                "exp_avg_sq": held[f"{i}.second_moment"].to(parameter.device),
            }
    return json.loads(metadata["state"]), held
