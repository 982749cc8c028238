"""Where networks are trained and maps are computed: on the processor, or on a GPU by torch."""

from __future__ import annotations

from importlib.util import find_spec

from esd.common import InputError


def usable_device(name: str) -> str:
    """`cpu` or `cuda`, of these names or of `auto`: a GPU where there is one.

    Raises
    ------
    InputError
        If there is no GPU that torch can use, or the name is another.
    """
    if name not in ("cpu", "cuda", "auto"):
        raise InputError(f"There is no device '{name}'; expected cpu, cuda or auto.")
    if name == "cpu" or (name == "auto" and find_spec("torch") is None):
        return "cpu"
    import torch

    if torch.cuda.is_available():
        return "cuda"
    if name == "auto":
        return "cpu"
    raise InputError(
        "torch finds no GPU here: install a build of torch for CUDA and a driver, or take "
        "--device cpu."
    )
