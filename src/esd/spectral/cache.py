"""A folder of computed arrays, each found by the content and parameters it was computed from."""

from __future__ import annotations

import hashlib
import json
import logging
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import platformdirs

from esd.common import InputError, whole_file

_log = logging.getLogger(__name__)

_FORMAT = 2  # raised when what is stored under a key changes

_DIGEST = "digest"  # name of the array that holds the digest of the others

Arrays = dict[str, npt.NDArray[Any]]


@dataclass(frozen=True, slots=True)
class Cache:
    """A cache folder that forgets what was not used for longest when it grows beyond its limit.

    Several processes may share one. A folder that cannot be written to is reported once in the
    log and costs nothing else.

    Parameters
    ----------
    folder
        Made when first needed.
    limit
        Size in bytes.
    """

    folder: Path
    limit: int

    def load(self, key: str) -> Arrays | None:
        """The arrays stored under a key, or None; a damaged entry is removed."""
        path = self._path(key)
        try:
            with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
                if sum(part.file_size for part in archive.zip.infolist()) > path.stat().st_size:
                    raise ValueError("it is compressed, which entries are not")
                arrays = dict(archive)
            digest = arrays.pop(_DIGEST, None)
            if digest is None or str(digest) != _digest(arrays):
                raise ValueError("its arrays are not those that were stored")
            os.utime(path)
            _log.info("Found in the cache: %s", path)
        except (FileNotFoundError, NotADirectoryError):
            return None
        except Exception as error:  # zipfile and numpy fail in many ways on damaged files
            _log.warning("The cache entry '%s' is damaged and is computed again: %s", path, error)
            try:
                path.unlink(missing_ok=True)
            except OSError:
                return None
            return None
        return arrays

    def store(self, key: str, arrays: Mapping[str, npt.NDArray[Any]]) -> None:
        """Store arrays under a key, then remove the least recently used beyond the limit."""
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            with whole_file(self._path(key)) as temporary:
                digest = np.array(_digest(arrays))
                np.savez(temporary, **arrays, **{_DIGEST: digest})  # type: ignore[arg-type]
            self._trim()
        except (OSError, InputError) as error:
            _log.warning("The cache '%s' cannot be written to: %s", self.folder, error)

    def computed(self, key: str, compute: Callable[[], Arrays]) -> Arrays:
        """The arrays stored under a key; where there are none, they are computed and stored."""
        arrays = self.load(key)
        if arrays is None:
            arrays = compute()
            self.store(key, arrays)
        return arrays

    def entries(self) -> list[tuple[Path, int]]:
        """Files and their sizes in bytes, the least recently used first."""
        found = []
        for path in self.folder.glob("*.npz"):
            try:
                status = path.stat()
            except FileNotFoundError:  # another process removed it
                continue
            found.append((status.st_mtime, path, status.st_size))
        return [(path, size) for _, path, size in sorted(found)]

    def clear(self) -> None:
        """Remove everything."""
        for path, _ in self.entries():
            path.unlink(missing_ok=True)

    def _trim(self) -> None:
        entries = self.entries()
        excess = sum(size for _, size in entries) - self.limit
        for path, size in entries[:-1]:  # never the one just stored
            if excess <= 0:
                break
            path.unlink(missing_ok=True)
            excess -= size

    def _path(self, key: str) -> Path:
        return self.folder / f"{key}.npz"


def default_cache() -> Cache | None:
    """The user's cache.

    The environment variable `ESD_CACHE` names another folder, or is `off` for none;
    `ESD_CACHE_LIMIT` is its size in gigabytes, 4 where it is not set. Without either a user who
    has no home folder has no cache, which the log says.

    Raises
    ------
    InputError
        If `ESD_CACHE_LIMIT` is not a finite number from 0 on.
    """
    folder = os.environ.get("ESD_CACHE", "")
    if folder.lower() == "off":
        return None
    limit = os.environ.get("ESD_CACHE_LIMIT", "4")
    try:
        size = int(float(limit) * 1e9)
        if size < 0:
            raise ValueError
    except (ValueError, OverflowError) as error:
        raise InputError(
            f"ESD_CACHE_LIMIT must be a number of gigabytes; got '{limit}'."
        ) from error
    if folder:
        return Cache(Path(folder), size)
    try:
        return Cache(platformdirs.user_cache_path("esd"), size)
    except RuntimeError:
        _log.warning("There is no home folder for a cache of spectra; name a folder in ESD_CACHE.")
        return None


def content_key(what: str, *arrays: npt.NDArray[Any], **parameters: object) -> str:
    """Key of what is computed from arrays and parameters: equal if and only if they are.

    Parameters
    ----------
    what
        Name of what is computed; it is the head of the key.
    """
    digest = hashlib.sha256()
    head = {"format": _FORMAT, "what": what, **parameters}
    digest.update(json.dumps(head, sort_keys=True, default=str).encode())
    for array in arrays:
        digest.update(f"{array.dtype.str}{array.shape}".encode())
        # a view, not `tobytes`: the descriptors of a training are the largest array there is
        digest.update(np.ascontiguousarray(array).reshape(-1).view(np.uint8).data)
    return f"{what}-{digest.hexdigest()[:40]}"


def _digest(arrays: Mapping[str, npt.NDArray[Any]]) -> str:
    """Digest of the names, types, shapes and content of arrays."""
    names = sorted(arrays)
    return content_key("arrays", *(np.asarray(arrays[name]) for name in names), names=names)
