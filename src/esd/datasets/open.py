"""A data set by what the user calls it."""

from __future__ import annotations

import os

from esd.datasets.bodies import bodies
from esd.datasets.collection import Collection
from esd.datasets.folder import folder_collection


def open_collection(dataset: str | os.PathLike[str]) -> Collection:
    """The collection `bodies`, remeshed, or the one in a folder, see `folder_collection`.

    Raises
    ------
    InputError
        If there is none.
    """
    if str(dataset) == "bodies":
        return bodies()
    return folder_collection(dataset)
