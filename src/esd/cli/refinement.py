"""The option `--refine`, until maps can be refined."""

from __future__ import annotations

from esd.common import InputError


def check_refinement(refine: bool | None) -> None:
    """Refuse what is not there yet: maps are the nearest neighbours of the embedding.

    Raises
    ------
    InputError
        If refinement is asked for.
    """
    if refine:
        raise InputError("Refinement is not available yet; leave out --refine.")
