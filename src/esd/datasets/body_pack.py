"""The file of the bodies that ship with the package, and how a body is posed."""

from __future__ import annotations

import os
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
import numpy.typing as npt

from esd.common import FloatArray, InputError, IntArray

STEP = 4e-5  # metres between the stored coordinates of the rest shapes; 16 bits reach 1.3 m
GRID = 1e-5  # metres; posed coordinates are rounded to it, so that they are the same everywhere


@dataclass(frozen=True, slots=True, eq=False)
class Pack:
    """Subjects at rest, and how their bones move in each pose; n vertices, b bones.

    Parameters
    ----------
    rest : (s, n, 3)
        Vertices of each subject at rest, in metres; x to the body's left, y to its back, z up.
    faces : (m, 3)
        Triangles of every subject, counter-clockwise seen from outside.
    weights : (n, b)
        Share of each bone in the motion of each vertex; rows sum to one.
    motions : (s, p, b, 3, 4)
        Motion of each bone from rest to pose: a rotation and, in the last column, a translation.
    mirror : (n,)
        Vertex on the other side of the body, exact: at rest the two are mirror images.
    parts : (n,)
        Part of the body each vertex belongs to, an index into `esd.datasets.bodies.PARTS`.
    samples : (s, p, k, 3)
        Positions of k vertices, `sampled(n, count=k)`, in each pose at the full precision of the
        model, against which reading can be checked.
    """

    rest: FloatArray
    faces: IntArray
    weights: FloatArray
    motions: FloatArray
    mirror: IntArray
    parts: IntArray
    samples: FloatArray


def skinned(rest: FloatArray, weights: FloatArray, motion: FloatArray) -> FloatArray:
    """Vertices moved by the bones, (n, 3): linear blend skinning.

    Parameters
    ----------
    rest : (n, 3)
        Vertices at rest.
    weights : (n, b)
        Share of each bone in the motion of each vertex.
    motion : (b, 3, 4)
        Motion of each bone.
    """
    blended = (weights @ motion.reshape(len(motion), 12)).reshape(-1, 3, 4)
    return np.asarray(np.einsum("nij,nj->ni", blended[:, :, :3], rest) + blended[:, :, 3])


def posed(pack: Pack, *, subject: int, pose: int) -> npt.NDArray[np.float64]:
    """Vertices of one subject in one pose, (n, 3), in metres."""
    vertices = skinned(pack.rest[subject], pack.weights, pack.motions[subject, pose])
    return np.asarray(np.round(vertices / GRID) * GRID, dtype=np.float64)


def sampled(vertex_count: int, *, count: int) -> IntArray:
    """Vertices whose positions are stored at full precision, (count,), spread over the mesh."""
    return np.arange(count, dtype=np.int64) * (vertex_count // count)


def write_pack(pack: Pack, path: str | os.PathLike[str]) -> None:
    """Write a pack; equal packs give equal files.

    Rest shapes are stored in whole steps of 0.04 mm, weights and motions in single precision.

    Raises
    ------
    InputError
        If a vertex at rest lies further than 1.3 m from the origin along an axis.
    """
    steps = np.round(pack.rest / STEP)
    if np.abs(steps).max() > np.iinfo(np.int16).max:
        raise InputError(
            "Coordinates of the rest shapes must lie within 1.3 m of the origin; "
            f"the largest is {np.abs(pack.rest).max():.3f} m."
        )
    vertex, bone = np.nonzero(pack.weights > 0)
    with Path(path).open("wb") as file:
        np.savez_compressed(
            file,
            rest=steps.astype(np.int16),
            faces=pack.faces.astype(np.uint16),
            weight=pack.weights[vertex, bone].astype(np.float32),
            weight_vertex=vertex.astype(np.uint16),
            weight_bone=bone.astype(np.uint8),
            motions=pack.motions.astype(np.float32),
            mirror=pack.mirror.astype(np.uint16),
            parts=pack.parts.astype(np.uint8),
            samples=pack.samples.astype(np.float64),
        )


def read_pack(path: str | os.PathLike[str]) -> Pack:
    """The pack stored in a file; its arrays are read-only."""
    with np.load(path, allow_pickle=False) as stored:
        rest = stored["rest"] * STEP
        weights = np.zeros((rest.shape[1], stored["motions"].shape[2]))
        weights[stored["weight_vertex"], stored["weight_bone"]] = stored["weight"]
        pack = Pack(
            rest=rest,
            faces=stored["faces"].astype(np.int64),
            weights=weights / weights.sum(axis=1, keepdims=True),
            motions=stored["motions"].astype(np.float64),
            mirror=stored["mirror"].astype(np.int64),
            parts=stored["parts"].astype(np.int64),
            samples=stored["samples"],
        )
    for field in fields(pack):
        getattr(pack, field.name).flags.writeable = False
    return pack
