"""Human bodies that ship with the package: 14 people of very different build, each in ten poses."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from importlib import resources

import numpy as np
import numpy.typing as npt

from esd.common import IntArray
from esd.datasets.body_pack import Pack, posed, read_pack
from esd.datasets.collection import Collection, Shape
from esd.datasets.remeshing import remeshed_shape
from esd.mesh.mesh import Mesh
from esd.mesh.remesh.styles import Style

TRAINING_SUBJECTS = tuple(f"s{number:02d}" for number in range(10))
TESTING_SUBJECTS = tuple(f"s{number:02d}" for number in range(10, 14))
POSE_COUNT = 10

PARTS = (
    "torso",
    "head",
    "left arm",
    "right arm",
    "left hand",
    "right hand",
    "left leg",
    "right leg",
    "left foot",
    "right foot",
)
"""Names of the parts of the body, in the order of their labels."""


def bodies(
    *,
    remeshed: bool = True,
    vertex_count: int = 5000,
    style: str | Style = "graded",
    seed: int = 0,
) -> Collection:
    """The bodies, 140 shapes named `s03_p07` for pose 7 of subject s03.

    Models are trained on `TRAINING_SUBJECTS` and tested on `TESTING_SUBJECTS`, who are nowhere
    else. Coordinates are in metres; x points to the body's left, y to its back, z up. The template
    has 6,891 points and is symmetric: `symmetric` is exact.

    Parameters
    ----------
    remeshed : bool
        Whether each shape gets triangles of its own, as shapes from a scanner have. If not, all
        have the template's, and a network may learn from those what it should from the surface.
    vertex_count, style
        Number of vertices of the remeshed shapes, and what their triangles are like; see
        `esd.mesh.remesh.remesh`.
    seed : int
        Of the triangles. They differ from shape to shape, and are the same in each call.
    """
    shapes = []
    for subject, name in enumerate(TRAINING_SUBJECTS + TESTING_SUBJECTS):
        for pose in range(POSE_COUNT):
            body = _Body(subject, pose)
            shape = Shape(
                name=f"{name}_p{pose:02d}",
                subject=name,
                template="body",
                mesh=body.mesh,
                correspondence=body.points,
                symmetric=mirrored_points,
                parts=part_names,
            )
            if remeshed:
                own = int(np.random.SeedSequence([seed, subject, pose]).generate_state(1)[0])
                shape = remeshed_shape(shape, vertex_count=vertex_count, style=style, seed=own)
            shapes.append(shape)
    name = "bodies" if remeshed else "bodies-registered"
    return Collection(name, tuple(shapes), TESTING_SUBJECTS)


def mirrored_points() -> IntArray:
    """The point of the template on the other side of the body, (p,)."""
    return _pack().mirror


def part_labels() -> IntArray:
    """Part of the body of each point of the template, (p,), an index into `PARTS`."""
    return _pack().parts


def part_names() -> npt.NDArray[np.str_]:
    """The same by name, (p,)."""
    return np.array(PARTS)[part_labels()]


@cache
def _pack() -> Pack:
    with resources.as_file(resources.files("esd.datasets") / "data" / "bodies.npz") as path:
        return read_pack(path)


@dataclass(frozen=True, slots=True)
class _Body:
    """One body with the triangles of the template."""

    subject: int
    pose: int

    def mesh(self) -> Mesh:
        pack = _pack()
        return Mesh(posed(pack, subject=self.subject, pose=self.pose), pack.faces)

    def points(self) -> IntArray:
        return np.arange(len(_pack().mirror))
