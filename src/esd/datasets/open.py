"""A data set by what the user calls it."""

from __future__ import annotations

import os

from esd.datasets.bodies import bodies
from esd.datasets.collection import Collection
from esd.datasets.dyna import dyna_collection, is_dyna
from esd.datasets.folder import folder_collection
from esd.datasets.store import is_store, store_collection


def open_collection(dataset: str | os.PathLike[str]) -> Collection:
    """The collection of a name, or in a file or folder.

    `bodies`, with triangles of their own; `bodies-registered`, with those of their template; a
    store, see `store_collection`; an HDF5 file of Dyna or D-FAUST, or a folder of such, see
    `dyna_collection`; else what `folder_collection` reads.

    Raises
    ------
    InputError
        If there is none.
    """
    if str(dataset) in ("bodies", "bodies-registered"):
        return bodies(remeshed=str(dataset) == "bodies")
    if is_store(dataset):
        return store_collection(dataset)
    if is_dyna(dataset):
        return dyna_collection(dataset)
    return folder_collection(dataset)
