"""Splits of a collection; shapes of one subject are never on both sides."""

from __future__ import annotations

import numpy as np

from esd.common import InputError
from esd.datasets.collection import Collection


def split_by_subject(
    collection: Collection, *, held_out: int, seed: int = 0
) -> tuple[Collection, Collection]:
    """The shapes of all but some subjects, and those of `held_out` subjects drawn at random.

    Raises
    ------
    InputError
        If there are not more subjects than `held_out`.
    """
    subjects = collection.subjects
    if not 1 <= held_out < len(subjects):
        raise InputError(
            f"`held_out` must be from 1 to {len(subjects) - 1}, one less than the subjects of "
            f"'{collection.name}'; got {held_out}."
        )
    chosen = set(np.random.default_rng(seed).permutation(len(subjects))[:held_out].tolist())
    kept = [subject for i, subject in enumerate(subjects) if i not in chosen]
    held = [subject for i, subject in enumerate(subjects) if i in chosen]
    return collection.of_subjects(kept), collection.of_subjects(held)
