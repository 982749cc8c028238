"""Dyna and D-FAUST: sequences of registered bodies in HDF5 files, read one frame at a time."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from functools import partial
from itertools import groupby
from pathlib import Path

import h5py
import numpy as np

from esd.common import InputError, whole_file
from esd.datasets.collection import Collection, Shape
from esd.datasets.hdf5 import about_damage, check_self_contained
from esd.datasets.splits import sample_by_subject
from esd.mesh.mesh import Mesh

HDF5_SUFFIXES = (".h5", ".hdf5")
"""Suffixes by which such files are found in a folder."""

TESTING_SUBJECTS = ("50020", "50021", "50025", "50002")
"""Subjects that the paper's comparison (its table 2) tests on."""

_NAME = re.compile(r"(\d+)_(.+)")
_FRAMES = "frames"  # attribute of the sequences in a selection: numbers of the frames it kept


@dataclass(frozen=True, slots=True)
class Recording:
    """One sequence of one subject.

    Parameters
    ----------
    file
        Where it lies.
    subject, sequence
        Such as `50002` and `one_leg_jump`: the name before and after its first underscore.
    frames
        Number of each frame, in order; a selection has gaps.
    vertex_count
        Of each of its meshes.
    """

    file: Path
    subject: str
    sequence: str
    frames: tuple[int, ...]
    vertex_count: int

    @property
    def key(self) -> str:
        """Name of the sequence in the file."""
        return f"{self.subject}_{self.sequence}"


def is_dyna(path: str | os.PathLike[str]) -> bool:
    """Whether a path is an HDF5 file, or a folder of such files, whatever their names say."""
    path = Path(path)
    return bool(_files(path)) if path.is_dir() else path.is_file() and h5py.is_hdf5(path)


def recordings(path: str | os.PathLike[str]) -> tuple[Recording, ...]:
    """The sequences in a file, or in all files of a folder, by subject and name.

    Only the index is read.

    Raises
    ------
    InputError
        If a file is cut short or has another layout, or a sequence is there twice.
    """
    path = Path(path)
    files = _files(path) if path.is_dir() else [path]
    found = sorted(
        (recording for file in files for recording in _recordings(file)),
        key=lambda recording: (recording.subject, recording.sequence),
    )
    for key, group in groupby(found, key=lambda recording: recording.key):
        twice = [str(recording.file) for recording in group]
        if len(twice) > 1:
            raise InputError(f"'{key}' is in {' and in '.join(twice)}; keep one of them.")
    if not found:
        raise InputError(f"There is no sequence of Dyna or D-FAUST in '{path}'.")
    return tuple(found)


def dyna_collection(path: str | os.PathLike[str]) -> Collection:
    r"""Every frame in a file, or in all files of a folder, named such as `50002_hips\00515`.

    Equal indices of vertices correspond. A mesh is read when it is asked for; nothing else of its
    sequence is.

    Raises
    ------
    InputError
        If a file is cut short or has another layout.
    """
    shapes = []
    for recording in recordings(path):
        shapes += [
            Shape(
                name=f"{recording.key}\\{number:05d}",
                subject=recording.subject,
                template="body",
                mesh=partial(_read_frame, recording, place),
                correspondence=partial(np.arange, recording.vertex_count),
            )
            for place, number in enumerate(recording.frames)
        ]
    return Collection(Path(path).resolve().stem, tuple(shapes), TESTING_SUBJECTS)


def save_selection(
    path: str | os.PathLike[str],
    output: str | os.PathLike[str],
    *,
    per_subject: int = 10,
    seed: int = 0,
) -> int:
    """Write some frames of each subject, drawn at random, to a small file; returns their number.

    The file has the layout of its source, and its frames keep their names: experiments on it need
    the gigabytes of the source no more. The paper's comparison takes ten of each subject.

    Raises
    ------
    InputError
        If the source cannot be read or the file cannot be written.
    """
    collection = sample_by_subject(dyna_collection(path), per_subject, seed=seed)
    meshes = [(shape.name.split("\\"), shape.mesh()) for shape in collection.shapes]
    with whole_file(output) as temporary, h5py.File(temporary, "w") as file:
        file["faces"] = meshes[0][1].faces
        for key, group in groupby(meshes, key=lambda item: item[0][0]):
            frames = [(int(name[1]), mesh.vertices) for name, mesh in group]
            file[key] = np.stack([vertices for _, vertices in frames], axis=2)
            file[key].attrs[_FRAMES] = [number for number, _ in frames]
    return len(meshes)


def _files(folder: Path) -> list[Path]:
    return sorted(file for file in folder.iterdir() if file.suffix.lower() in HDF5_SUFFIXES)


def _open(file: Path) -> h5py.File:
    try:
        return h5py.File(file, "r")
    except FileNotFoundError:
        raise InputError(f"There is no file '{file}'.") from None
    except OSError as error:  # h5py compares the length with the one the file states
        raise InputError(f"'{file}' is no HDF5 file or is cut short: {error}.") from error


def _recordings(file: Path) -> list[Recording]:
    with _open(file) as content, about_damage(file):
        check_self_contained(content)
        if not isinstance(content.get("faces"), h5py.Dataset):
            raise InputError(
                f"'{file}' has no data set 'faces'; it is not of the layout of Dyna and D-FAUST."
            )
        if content["faces"].ndim != 2 or content["faces"].shape[1] != 3:
            raise InputError(
                f"'{file}': expected faces of shape (F, 3), got {content['faces'].shape}."
            )
        found: list[Recording] = []
        for key, sequence in content.items():
            name = _NAME.fullmatch(key)
            if key == "faces" or name is None or not isinstance(sequence, h5py.Dataset):
                continue
            if sequence.ndim != 3 or sequence.shape[1] != 3:
                raise InputError(
                    f"'{file}', '{key}': expected shape (V, 3, T), got {sequence.shape}."
                )
            count = sequence.shape[0]
            if found and count != found[0].vertex_count:
                raise InputError(
                    f"'{file}': '{key}' has {count} vertices, "
                    f"'{found[0].key}' {found[0].vertex_count}."
                )
            frames = tuple(map(int, sequence.attrs.get(_FRAMES, range(sequence.shape[2]))))
            found.append(Recording(file, name[1], name[2], frames, count))
    return found


def _read_frame(recording: Recording, place: int) -> Mesh:
    with _open(recording.file) as content, about_damage(recording.file):
        try:
            vertices = content[recording.key][:, :, place].astype(np.float64)
            faces = content["faces"][:].astype(np.int64)
        except OSError as error:
            raise InputError(
                f"'{recording.file}', '{recording.key}', frame {recording.frames[place]} "
                f"cannot be read: {error}."
            ) from error
    return Mesh(vertices, faces)
