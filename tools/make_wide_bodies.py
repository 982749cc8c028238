"""Generate people of every build, far from standing at ease, with the triangles of real data.

    pip install -e . -r tools/requirements-bodies.txt
    python tools/make_wide_bodies.py FOLDER --sheet /tmp/wide.png

The default model is trained on them and on the bodies that ship, see `tools/bundle_models.py`. They
come from the same body model and have the same template as `tools/make_bodies.py` makes: children,
old, heavy, thin and muscular people, who bend, crouch, twist, and reach up, back and across, their
hands open or closed. Each has triangles of its own: remeshed, decimated by curvature or along some
direction, with defects, or with limbs welded where they are near each other. The folder has the
layout of `esd.datasets.export`. Equal calls write equal folders.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path

import numpy as np
import torch
from make_bodies import (
    Arm,
    Leg,
    Pose,
    Skin,
    Trunk,
    about,
    bone_rotations,
    draw,
    eased,
    joints,
    least_crossing,
    skin,
)
from scipy.spatial.transform import Rotation
from sheet import sheet

from esd.datasets.collection import Collection, Shape
from esd.datasets.export import export_folder
from esd.datasets.remeshing import COARSEST, DENSEST, remeshed_shape
from esd.mesh.mesh import Mesh
from esd.mesh.remesh.styles import STYLES
from esd.parallel import THIS_PROCESS

sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks"))
from real_triangles import Altered, altered

TRIES = 12  # draws of one pose
CROSSINGS = 20  # pairs of faces that may pass through each other: bent elbows, heavy bellies

# of one shape after another: a style of remeshing, or one of `real_triangles.KINDS`
TRIANGLES = (
    *("graded", "long", "even", "defective", "adaptive", "welded"),
    *("graded", "by curvature", "rough", "long", "stretched"),
)


@dataclass(frozen=True)
class Wide:
    """Body `pose` of person `number`; the triangles are those of the template."""

    name: str
    vertices: np.ndarray
    crossings: int


def phenotype(random: np.random.Generator) -> tuple[float, ...]:
    """A person: the extremes of each trait are more frequent than its middle.

    A fifth are children, a fifth old.
    """
    kind = random.random()
    ages = (0.36, 0.6) if kind < 0.22 else (0.6, 0.8) if kind < 0.8 else (0.8, 1.0)
    gender, age = random.beta(0.5, 0.5), random.uniform(*ages)
    muscle, weight, proportions = random.beta(0.7, 0.7, size=3)
    height, cupsize = random.uniform(0.2, 0.7), random.random()
    traits = (gender, age, muscle, weight, height, proportions, cupsize)
    return tuple(map(float, (*traits, *random.dirichlet([0.6, 0.6, 0.6]))))


def rotations(
    random: np.random.Generator, heads: dict[str, np.ndarray], *, weight: float
) -> dict[str, Rotation]:
    """Rotation of each bone that moves, in a pose that people can reach, if not at ease."""

    def u(low: float, high: float) -> float:
        return float(random.uniform(low, high))

    def arm() -> Arm:
        elbow = u(5, 125) if random.random() < 0.6 else u(5, 40)
        curl = u(-5, 75) if random.random() < 0.6 else u(0, 25)
        return Arm(u(-70, 75), u(-50, 95), elbow, curl, u(-45, 45))

    def leg() -> Leg:
        kind = random.random()
        if kind < 0.35:  # standing
            return Leg(u(-8, 12), u(2, 14), u(0, 20), u(-10, 15))
        if kind < 0.65:  # crouching, kneeling
            return Leg(u(40, 110), u(-6, 35), u(30, 130), u(-25, 20))
        if kind < 0.85:  # striding, out to the side
            return Leg(u(-25, 40), u(0, 50), u(0, 90), u(-25, 20))
        return Leg(u(60, 100), u(-10, 30), u(0, 60), u(-25, 20))  # on the floor

    bend = u(-18, 60) if random.random() < 0.5 else u(-8, 10)
    trunk = Trunk(bend, u(-28, 28), u(-40, 40), u(-30, 30), u(-20, 20), u(-50, 50))
    near_arm, far_arm, near_leg, far_leg = arm(), arm(), leg(), leg()
    if random.random() < 0.35:  # both legs alike
        spread = max(near_leg.spread, 3)
        far_leg = replace(near_leg, flexion=near_leg.flexion + u(-6, 6), spread=spread)
    if random.random() < 0.3:
        far_arm = replace(near_arm)
    pose = eased(Pose(trunk, near_arm, far_arm, near_leg, far_leg), weight=weight)
    turns = bone_rotations(pose, heads, "L")
    for side, sign in (("L", 1), ("R", -1)):
        upper = heads[f"lowerarm01.{side}"] - heads[f"upperarm01.{side}"]
        fore = heads[f"wrist.{side}"] - heads[f"lowerarm01.{side}"]
        thigh = heads[f"lowerleg01.{side}"] - heads[f"upperleg01.{side}"]
        # about its own axis first, so that it still points where the pose says
        turns[f"upperarm01.{side}"] *= about(upper, sign * u(-70, 80))
        turns[f"lowerarm02.{side}"] = about(fore, sign * u(-50, 50))
        turns[f"upperleg01.{side}"] *= about(thigh, u(-30, 30))
        thumb = heads[f"finger1-2.{side}"] - heads[f"finger1-1.{side}"]
        for joint in "23":
            turns[f"finger1-{joint}.{side}"] = about(np.cross(thumb, fore), u(-20, 25))
    return turns


def people(made: Skin, *, people: int, poses: int, seed: int) -> list[Wide]:
    """Some people in some poses each."""
    found = []
    for number in range(people):
        random = np.random.default_rng([seed, number])
        traits = phenotype(random)
        heads = joints(made.model, traits)
        pose = partial(rotations, random, heads, weight=traits[3])
        for place in range(poses):
            crossings, _, vertices = least_crossing(
                made, traits, pose, tries=TRIES, enough=CROSSINGS
            )
            found.append(Wide(f"w{number:03d}_p{place:02d}", np.round(vertices, 5), crossings))
        print(f"w{number:03d}", [each.crossings for each in found[-poses:]], flush=True)
    return found


def with_triangles(shape: Shape, kind: str, seed: int) -> Shape:
    """A shape with other triangles, of a style of remeshing or of `real_triangles.KINDS`."""
    if kind in STYLES:
        count = COARSEST * (DENSEST / COARSEST) ** np.random.default_rng(seed).random()
        return remeshed_shape(shape, vertex_count=round(count), style=kind, seed=seed)

    @cache
    def made() -> Altered:
        return altered(shape.mesh(), kind, seed)

    def moved(index: np.ndarray) -> np.ndarray:
        return np.where(index >= 0, made()[1][index], -1)

    return replace(
        shape,
        mesh=lambda: made()[0],
        correspondence=lambda: moved(shape.correspondence()),
        symmetric=lambda: moved(shape.symmetric()),
    )


def collection(made: Skin, bodies: list[Wide]) -> Collection:
    """The bodies with triangles of their own, on the template of the bodies that ship."""
    shapes = []
    for place, body in enumerate(bodies):
        mesh = Mesh(body.vertices, made.template.faces)
        shape = Shape(
            name=body.name,
            subject=body.name[:4],
            template="body",
            mesh=lambda mesh=mesh: mesh,
            correspondence=lambda: np.arange(len(made.template.mirror)),
            symmetric=lambda: made.template.mirror,
        )
        shapes.append(with_triangles(shape, TRIANGLES[place % len(TRIANGLES)], place))
    return Collection("wide", tuple(shapes))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--people", type=int, default=48)
    parser.add_argument("--poses", type=int, default=5)
    parser.add_argument("--seed", type=int, default=1, help="of the people; 2 for those to test on")
    parser.add_argument("--sheet", type=Path, help="picture of the bodies to write")
    options = parser.parse_args()

    torch.set_num_threads(1)
    made = skin()
    bodies = people(made, people=options.people, poses=options.poses, seed=options.seed)
    if options.sheet:
        middles = [body.vertices.mean(axis=0) - [0, 0, 0.9] for body in bodies]
        shapes = [
            (body.name, Mesh(body.vertices - middle, made.template.faces))
            for body, middle in zip(bodies, middles, strict=True)
        ]
        draw_turned = partial(draw, azimuth=25)
        sheet(shapes, draw_turned, options.sheet, columns=10, size=(1.8, 2), dpi=50)
    export_folder(collection(made, bodies), options.folder, suffix=".ply", workers=THIS_PROCESS)


if __name__ == "__main__":
    main()
