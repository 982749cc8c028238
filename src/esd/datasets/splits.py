"""Splits and samples of a collection; shapes of one subject are never on both sides."""

from __future__ import annotations

from dataclasses import replace

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


def unseen_subjects(
    collection: Collection, *, patterns: str | None = None, least: int = 2
) -> tuple[Collection, Collection]:
    """Shapes to train on, and shapes of other subjects to test on.

    Parameters
    ----------
    patterns
        Names of the shapes to test on, see `Collection.including`; all shapes of their subjects
        are held out of the training. By default those of the collection's `testing_subjects`, or,
        where there are none, of the last quarter of its subjects, but of at least `least`.

    Raises
    ------
    InputError
        If no shape matches, or no subject is left to train on.
    """
    if patterns is not None:
        testing = collection.including(patterns)
    else:
        quarter = max(least, len(collection.subjects) // 4)
        testing = collection.of_subjects(
            collection.testing_subjects or sorted(collection.subjects)[-quarter:]
        )
    return collection.excluding_subjects(testing.subjects), testing


def sample_subjects(collection: Collection, count: int, *, seed: int = 0) -> Collection:
    """The shapes of at most `count` subjects, drawn at random, in the order of the collection."""
    order = np.random.default_rng(seed).permutation(len(collection.subjects))
    return collection.of_subjects([collection.subjects[i] for i in order[:count]])


def sample_by_subject(collection: Collection, count: int, *, seed: int = 0) -> Collection:
    """At most `count` shapes of each subject, drawn at random, in the order of the collection."""
    generator = np.random.default_rng(seed)
    chosen: set[int] = set()
    subjects = np.array([shape.subject for shape in collection.shapes])
    for subject in collection.subjects:
        places = np.flatnonzero(subjects == subject)
        chosen |= set(generator.permutation(places)[:count].tolist())
    return replace(
        collection, shapes=tuple(s for i, s in enumerate(collection.shapes) if i in chosen)
    )
