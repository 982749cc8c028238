"""Generate the human bodies that ship with the package, and a picture of them all.

    pip install -e . -r tools/requirements-bodies.txt
    python tools/make_bodies.py --sheet /tmp/bodies.png

The shapes come from the Anny body model (shape data of MakeHuman, CC0). Its surface is closed at
the mouth and the eyes, decimated once on the left half and mirrored, so that the template is
exactly symmetric; each of its vertices is a fixed mean of vertices of the full model. Subjects are
a table of phenotypes; poses are drawn from ten families of plausible movements, and drawn again
where the surface would pass through itself. What is stored is the rest shape of each subject, the
skinning weights, and the motion of each bone in each pose; `esd.datasets.bodies` poses them.
Equal calls write equal files.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import anny
import igl
import igl.copyleft.cgal
import numpy as np
import torch
from anny.face_segmentation import get_face_segmentation_mask
from matplotlib.collections import PolyCollection
from scipy import sparse
from scipy.spatial.transform import Rotation
from sheet import sheet

from esd.common import whole_file
from esd.datasets.bodies import PARTS
from esd.datasets.body_pack import Pack, posed, read_pack, sampled, skinned, write_pack
from esd.mesh.geometry import (
    components,
    edge_lengths,
    edges,
    face_areas,
    surface_area,
)
from esd.mesh.mesh import Mesh
from esd.mesh.topology import boundary_edges

POSES = 10
HALF_FACES = 6890  # of the decimated left half: about 6,900 vertices in all
TRIES = 20  # draws of one pose, of which the one with the fewest self-intersections is kept
SAMPLES = 16  # vertices whose exact positions are stored with each shape
PHENOTYPES = ("gender", "age", "muscle", "weight", "height", "proportions", "cupsize")
ANCESTRIES = ("african", "asian", "caucasian")  # shares
AVERAGE = (0.5, 0.67, 0.5, 0.5, 0.5, 0.5, 0.5, 1, 1, 1)

# gender 0 male, 1 female; age 0.67 young adult, 1 old; the rest from 0 to 1
SUBJECTS = {
    # training: two much alike, then ever further apart
    "s00": (0.0, 0.67, 0.50, 0.50, 0.33, 0.50, 0.5, 0, 0, 1),
    "s01": (0.1, 0.72, 0.60, 0.55, 0.36, 0.55, 0.5, 0, 0, 1),
    "s02": (1.0, 0.67, 0.45, 0.40, 0.40, 0.60, 0.4, 0, 1, 0),
    "s03": (1.0, 0.80, 0.30, 0.80, 0.35, 0.35, 0.8, 1, 0, 0),
    "s04": (0.0, 0.70, 1.00, 0.70, 0.48, 0.95, 0.5, 1, 0, 0),
    "s05": (1.0, 0.65, 0.55, 0.05, 0.52, 0.80, 0.2, 1, 0, 1),
    "s06": (0.0, 0.85, 0.15, 1.00, 0.38, 0.20, 0.5, 0, 0, 1),
    "s07": (1.0, 0.97, 0.20, 0.55, 0.24, 0.30, 0.6, 0, 1, 0),
    "s08": (0.0, 0.62, 0.30, 0.00, 0.60, 0.65, 0.5, 0, 0, 1),
    "s09": (1.0, 0.75, 0.05, 1.00, 0.26, 0.10, 0.4, 0, 1, 1),
    # testing only
    "s10": (0.0, 0.95, 0.35, 0.45, 0.28, 0.45, 0.5, 0, 1, 0),
    "s11": (1.0, 0.70, 0.85, 0.50, 0.52, 0.85, 0.3, 1, 0, 0),
    "s12": (0.0, 0.75, 0.35, 1.00, 0.42, 0.30, 0.5, 1, 1, 0),
    "s13": (1.0, 0.63, 0.25, 0.15, 0.33, 0.50, 0.5, 0, 0, 1),
}

# first match wins
PART_BONES = {
    "head": r"head|eye|neck0[23]",
    "hand": r"wrist|finger|metacarpal",
    "foot": r"foot|toe",
    "arm": r"upperarm|lowerarm",
    "leg": r"upperleg|lowerleg",
    "torso": r".*",
}


@dataclass(frozen=True)
class Template:
    """The decimated surface: (n, N) means of full vertices, faces, mirrored vertices."""

    means: sparse.csr_array
    faces: np.ndarray
    mirror: np.ndarray


# --- template -------------------------------------------------------------------------------------


def boundary_loops(faces: np.ndarray) -> list[list[int]]:
    """Loops of boundary vertices, each against the direction of its faces."""
    sides = {(int(a), int(b)) for f in faces for a, b in zip(f, np.roll(f, -1), strict=True)}
    following = {b: a for a, b in sorted(sides) if (b, a) not in sides}
    loops = []
    while following:
        loop = [min(following)]
        while (vertex := following.pop(loop[-1])) != loop[0]:
            loop.append(vertex)
        loops.append(loop)
    return sorted(loops, key=len)


def strip(points: np.ndarray, chain: list[int]) -> list[tuple[int, int, int]]:
    """Triangles between the two ends of a chain of vertices, the shorter diagonal first."""
    low, high, triangles = 0, len(chain) - 1, []
    while high - low > 1:
        lower = np.linalg.norm(points[chain[low + 1]] - points[chain[high]])
        upper = np.linalg.norm(points[chain[low]] - points[chain[high - 1]])
        if lower < upper:
            triangles.append((chain[low], chain[low + 1], chain[high]))
            low += 1
        else:
            triangles.append((chain[low], chain[high - 1], chain[high]))
            high -= 1
    return triangles


def closed_left_half(
    points: np.ndarray, faces: np.ndarray, cavity: np.ndarray
) -> tuple[np.ndarray, list[int]]:
    """Faces of the left half without cavities, and the loop around its eye.

    The mouth is closed by a strip of triangles, the eye by a fan around a vertex after the last.
    What is left open is the loop in the plane of symmetry.
    """
    half = faces[(points[faces][:, :, 0] >= 0).all(axis=1) & ~cavity]
    eye, loop = boundary_loops(half)
    middle = points[loop, 0] == 0
    start = next(i for i in range(len(loop)) if middle[i - 1] and not middle[i])
    loop = loop[start - 1 :] + loop[: start - 1]
    mouth = loop[: 2 + next(i for i in range(len(loop)) if points[loop[i + 1], 0] == 0)]
    fan = [(a, b, len(points)) for a, b in zip(eye, eye[1:] + eye[:1], strict=True)]
    return np.vstack([half, strip(points, mouth), fan]), eye


def nearest_on_segments(
    queries: np.ndarray, points: np.ndarray, segments: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Nearest segment of each query, and the place along it from 0 to 1."""
    start, along = points[segments[:, 0]], points[segments[:, 1]] - points[segments[:, 0]]
    place = np.einsum("qsk,sk->qs", queries[:, None] - start, along) / (along**2).sum(axis=1)
    place = place.clip(0, 1)
    gap = np.linalg.norm(start + place[:, :, None] * along - queries[:, None], axis=2)
    nearest = gap.argmin(axis=1)
    return nearest, place[np.arange(len(queries)), nearest]


def without_ears(points: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The open mesh without vertices of a single face: mirrored, they would be folded flat."""
    while (single := np.bincount(faces.ravel()) == 1).any():
        faces = faces[~single[faces].any(axis=1)]
        used, packed = np.unique(faces, return_inverse=True)
        points, faces = points[used], packed.reshape(-1, 3)
    return points, faces


def decimated_template(model: Any) -> Template:
    """The closed surface, decimated on one half and mirrored."""
    full = model.template_vertices.numpy()
    count = len(full)
    by_position = {tuple(p): i for i, p in enumerate(full.tolist())}
    mirrored = np.array([by_position[-x if x else x, y, z] for x, y, z in full.tolist()])
    cavity = get_face_segmentation_mask(model, ["mouth_cavity", "eye_cavity.L", "eye_cavity.R"])
    faces, eye = closed_left_half(full, model.faces.numpy(), cavity.numpy())

    # one row more: the middle of the eye
    rows = [*range(count), *[count] * len(eye)]
    weights = [1.0] * count + [1 / len(eye)] * len(eye)
    extended = sparse.csr_array((weights, (rows, [*range(count), *eye])), (count + 1, count))
    adult = rest_shape(model, AVERAGE)
    adult = (adult + adult[mirrored] * [-1, 1, 1]) / 2
    points = extended @ adult
    used, packed = np.unique(faces, return_inverse=True)
    half, half_faces = points[used], packed.reshape(-1, 3)

    # shortest edges first: near-uniform triangles
    collapsed, collapsed_faces, _, _ = igl.decimate(
        np.asfortranarray(half), np.asfortranarray(half_faces.astype(np.int32)), HALF_FACES, False
    )
    collapsed, collapsed_faces = without_ears(np.asarray(collapsed), np.asarray(collapsed_faces))

    # tie every vertex to the full surface again: interior ones to its faces, those of the open
    # loop to its edges in the plane of symmetry
    _, face, foot = igl.point_mesh_squared_distance(
        np.ascontiguousarray(collapsed), half, half_faces.astype(np.int64)
    )
    corners = [np.ascontiguousarray(half[half_faces[face, i]]) for i in range(3)]
    share = igl.barycentric_coordinates(np.ascontiguousarray(foot), *corners).clip(0)
    share /= share.sum(axis=1, keepdims=True)
    corner = half_faces[face]
    middle = np.unique(boundary_edges(Mesh(collapsed, collapsed_faces)))
    rim = boundary_edges(Mesh(half, half_faces))
    segment, place = nearest_on_segments(collapsed[middle], half, rim)
    corner[middle, :2] = rim[segment]
    share[middle] = np.stack([1 - place, place, 0 * place], axis=1)

    size = len(collapsed)
    index = np.repeat(np.arange(size), 3)
    left = sparse.csr_array((share.ravel(), (index, used[corner.ravel()])), (size, count + 1))
    left = left @ extended
    swap = sparse.csr_array((np.ones(count), (np.arange(count), mirrored)))
    sides = np.setdiff1d(np.arange(size), middle)
    other = np.arange(size)
    other[sides] = size + np.arange(len(sides))
    right = (left @ swap)[sides]
    # the loop's vertices are their own mirror images, up to the model's rounding
    means = sparse.vstack([left, right]).tocsr()
    both = np.vstack([collapsed_faces, other[collapsed_faces][:, ::-1]])
    return Template(means, both, np.concatenate([other, sides]))


# --- subjects and poses ---------------------------------------------------------------------------


def posed_model(model: Any, phenotype: tuple[float, ...], pose: np.ndarray) -> dict[str, Any]:
    values = dict(zip(PHENOTYPES + ANCESTRIES, phenotype, strict=True))
    with torch.no_grad():
        return model(pose_parameters=torch.as_tensor(pose)[None], phenotype_kwargs=values)


def identity_pose(model: Any) -> np.ndarray:
    return np.tile(np.eye(4), (model.bone_count, 1, 1))


def rest_shape(model: Any, phenotype: tuple[float, ...]) -> np.ndarray:
    return posed_model(model, phenotype, identity_pose(model))["rest_vertices"][0].numpy()


def joints(model: Any, phenotype: tuple[float, ...]) -> dict[str, np.ndarray]:
    """Where each bone begins in the reference pose."""
    output = posed_model(model, phenotype, identity_pose(model))
    heads = output["bone_poses"][0, :, :3, 3].numpy()
    return dict(zip(model.bone_labels, heads, strict=True))


def unit(vector: np.ndarray) -> np.ndarray:
    return vector / np.linalg.norm(vector)


def aimed(source: np.ndarray, target: np.ndarray) -> Rotation:
    """The smallest rotation that turns one direction into another."""
    axis = np.cross(unit(source), unit(target))
    angle = np.arctan2(np.linalg.norm(axis), unit(source) @ unit(target))
    return Rotation.from_rotvec(angle * unit(axis)) if angle > 1e-9 else Rotation.identity()


def about(axis: np.ndarray, degrees: float) -> Rotation:
    return Rotation.from_rotvec(np.radians(degrees) * unit(axis))


X, Y, Z = np.eye(3)  # to the body's left, to its back, up


@dataclass
class Arm:
    """Angles in degrees: of the upper arm above the horizontal and to the front, of the joints."""

    elevation: float = -50
    front: float = 5
    elbow: float = 20
    curl: float = 15
    wrist: float = 0


@dataclass
class Leg:
    """Angles in degrees."""

    flexion: float = 0
    spread: float = 5
    knee: float = 5
    ankle: float = 0


@dataclass
class Trunk:
    """Angles in degrees, of the whole spine and of the neck with the head."""

    bend: float = 0
    side: float = 0
    twist: float = 0
    nod: float = 0
    tilt: float = 0
    turn: float = 0


@dataclass
class Pose:
    """Pose of a body; 'near' and 'far' become left and right or the other way round."""

    trunk: Trunk
    near_arm: Arm
    far_arm: Arm
    near_leg: Leg
    far_leg: Leg


def draw_pose(family: int, random: np.random.Generator) -> Pose:
    """One pose of a family, its angles drawn from ranges that people reach at ease."""

    def u(low: float, high: float) -> float:
        return float(random.uniform(low, high))

    def arm(
        elevation: tuple[float, float], front: tuple[float, float], elbow: tuple[float, float]
    ) -> Arm:
        return Arm(u(*elevation), u(*front), u(*elbow), curl=u(5, 35), wrist=u(-15, 15))

    def hanging() -> Arm:
        return arm((-58, -42), (-5, 20), (8, 40))

    def leg(
        flexion: tuple[float, float], spread: tuple[float, float], knee: tuple[float, float]
    ) -> Leg:
        return Leg(u(*flexion), u(*spread), u(*knee), ankle=u(-8, 12))

    def standing() -> Leg:
        return leg((-4, 6), (3, 10), (2, 10))

    head = {"nod": u(-12, 12), "tilt": u(-8, 8), "turn": u(-20, 20)}
    trunk = Trunk(u(-4, 6), u(-4, 4), u(-6, 6), **head)
    match family:
        case 0:  # standing at ease
            return Pose(trunk, hanging(), hanging(), standing(), standing())
        case 1:  # walking
            trunk.twist = u(4, 12)
            return Pose(
                trunk,
                arm((-62, -50), (-60, -35), (10, 35)),
                arm((-60, -45), (50, 75), (20, 55)),
                leg((20, 36), (2, 6), (5, 22)),
                leg((-22, -10), (2, 6), (12, 40)),
            )
        case 2:  # arms raised
            return Pose(
                trunk,
                arm((40, 68), (0, 25), (5, 40)),
                arm((40, 68), (0, 25), (5, 40)),
                leg((-4, 8), (4, 14), (2, 14)),
                standing(),
            )
        case 3:  # as on a chair
            trunk.bend = u(5, 22)
            return Pose(
                trunk,
                arm((-45, -5), (50, 80), (15, 55)),
                arm((-45, -5), (50, 80), (15, 55)),
                leg((54, 76), (8, 18), (50, 76)),
                leg((54, 76), (8, 18), (50, 76)),
            )
        case 4:  # twisted
            trunk.twist, trunk.turn = u(25, 42), u(10, 35)
            return Pose(
                trunk,
                arm((-20, 8), (-15, 15), (10, 45)),
                arm((-25, 5), (45, 70), (20, 60)),
                leg((-4, 8), (6, 14), (2, 14)),
                standing(),
            )
        case 5:  # one knee up
            return Pose(
                trunk,
                arm((-25, 12), (0, 25), (5, 40)),
                arm((-25, 12), (0, 45), (5, 50)),
                leg((52, 78), (4, 16), (50, 84)),
                standing(),
            )
        case 6:  # bent forward
            trunk.bend, trunk.nod = u(25, 45), u(-20, 10)
            return Pose(
                trunk,
                arm((-30, 10), (40, 75), (5, 40)),
                arm((-30, 10), (40, 75), (5, 40)),
                leg((20, 38), (4, 12), (8, 25)),
                leg((20, 38), (4, 12), (8, 25)),
            )
        case 7:  # lunging
            return Pose(
                trunk,
                arm((-35, 10), (20, 60), (20, 70)),
                arm((-50, -20), (-40, -10), (10, 50)),
                leg((46, 64), (3, 10), (48, 72)),
                leg((-24, -12), (3, 8), (12, 30)),
            )
        case 8:  # bent to one side, an arm over the head
            trunk.side, trunk.tilt = u(14, 26), u(0, 15)
            return Pose(
                trunk,
                hanging(),
                arm((50, 75), (0, 20), (15, 60)),
                leg((-4, 6), (8, 18), (2, 10)),
                leg((-4, 6), (8, 18), (2, 10)),
            )
        case _:  # a leg out, arms wide, one bent
            return Pose(
                trunk,
                arm((-10, 22), (-5, 30), (60, 100)),
                arm((-10, 22), (-5, 30), (5, 30)),
                leg((-4, 15), (26, 42), (3, 20)),
                standing(),
            )


def eased(pose: Pose, *, weight: float) -> Pose:
    """The pose as heavy people reach it: joints bent less, legs and arms further apart."""
    heavy = max(0.0, weight - 0.6) / 0.4
    for leg in (pose.near_leg, pose.far_leg):
        leg.flexion *= 1 - 0.3 * heavy
        leg.knee *= 1 - 0.2 * heavy
        leg.spread += 5 * heavy
    for arm in (pose.near_arm, pose.far_arm):
        arm.elevation = max(arm.elevation, -58 + 22 * heavy)
    pose.trunk.bend *= 1 - 0.4 * heavy
    return pose


def bone_rotations(pose: Pose, heads: dict[str, np.ndarray], near: str) -> dict[str, Rotation]:
    """Rotation of each bone that moves, about the body's axes."""
    far = "R" if near == "L" else "L"
    sign = 1 if near == "L" else -1
    trunk = pose.trunk
    turns: dict[str, Rotation] = {}
    for bone, share in (("05", 0.15), ("04", 0.25), ("03", 0.25), ("02", 0.2), ("01", 0.15)):
        turns[f"spine{bone}"] = Rotation.from_rotvec(
            share * np.radians([trunk.bend, sign * trunk.side, sign * trunk.twist])
        )
    for bone, share in (("neck01", 0.25), ("neck02", 0.25), ("neck03", 0.2), ("head", 0.3)):
        turns[bone] = Rotation.from_rotvec(
            share * np.radians([trunk.nod, sign * trunk.tilt, sign * trunk.turn])
        )
    for side, arm, leg in (
        (near, pose.near_arm, pose.near_leg),
        (far, pose.far_arm, pose.far_leg),
    ):
        turns |= arm_rotations(arm, heads, side) | leg_rotations(leg, heads, side)
    return turns


def arm_rotations(arm: Arm, heads: dict[str, np.ndarray], side: str) -> dict[str, Rotation]:
    out = X if side == "L" else -X
    upper = heads[f"lowerarm01.{side}"] - heads[f"upperarm01.{side}"]
    lower = heads[f"wrist.{side}"] - heads[f"lowerarm01.{side}"]
    up, front = np.radians([arm.elevation, arm.front])
    target = np.cos(up) * (np.cos(front) * out - np.sin(front) * Y) + np.sin(up) * Z
    whole = aimed(upper, target)
    # the collar bone and the shoulder take their share of the way, more when the arm goes up
    girdle = Rotation.from_rotvec((0.30 if arm.elevation > 0 else 0.12) * whole.as_rotvec())
    hinge = np.cross(upper, lower)
    bent = np.degrees(np.arccos(unit(upper) @ unit(lower)))
    turns = {
        f"clavicle.{side}": Rotation.from_rotvec(0.5 * girdle.as_rotvec()),
        f"shoulder01.{side}": Rotation.from_rotvec(0.5 * girdle.as_rotvec()),
        f"upperarm01.{side}": girdle.inv() * whole,
        f"lowerarm01.{side}": about(hinge, arm.elbow - bent),
        f"wrist.{side}": about(hinge, arm.wrist),
    }
    palm = np.cross(
        heads[f"finger2-1.{side}"] - heads[f"wrist.{side}"],
        heads[f"finger5-1.{side}"] - heads[f"wrist.{side}"],
    ) * (1 if side == "L" else -1)
    for finger in "2345":
        along = heads[f"finger{finger}-2.{side}"] - heads[f"finger{finger}-1.{side}"]
        for joint in "123":
            turns[f"finger{finger}-{joint}.{side}"] = about(np.cross(along, palm), arm.curl)
    return turns


def leg_rotations(leg: Leg, heads: dict[str, np.ndarray], side: str) -> dict[str, Rotation]:
    out = X if side == "L" else -X
    thigh = heads[f"lowerleg01.{side}"] - heads[f"upperleg01.{side}"]
    forward, spread = np.radians([leg.flexion, leg.spread])
    target = np.cos(spread) * (-np.sin(forward) * Y - np.cos(forward) * Z) + np.sin(spread) * out
    return {
        f"upperleg01.{side}": aimed(thigh, target),
        f"lowerleg01.{side}": about(X, leg.knee),
        f"foot.{side}": about(X, leg.ankle),
    }


def bone_motions(
    model: Any, phenotype: tuple[float, ...], turns: dict[str, Rotation]
) -> np.ndarray:
    """Motion of every bone from the rest pose, (b, 3, 4)."""
    pose = identity_pose(model)
    for bone, turn in turns.items():
        pose[model.bone_labels.index(bone), :3, :3] = turn.as_matrix()
    output = posed_model(model, phenotype, pose)
    rest, moved = (output[key][0].numpy() for key in ("rest_bone_poses", "bone_poses"))
    return (moved @ np.linalg.inv(rest))[:, :3]


# --- checks ---------------------------------------------------------------------------------------


def self_intersections(mesh: Mesh) -> int:
    """Number of pairs of faces that pass through each other."""
    pairs = igl.copyleft.cgal.remesh_self_intersections(
        np.array(mesh.vertices), np.array(mesh.faces), detect_only=True
    )[2]
    return len(pairs)


def distortion(first: Mesh, second: Mesh) -> float:
    """Mean relative change of the edge lengths from one shape to the other."""
    pairs = edges(first)
    one, two = (
        np.linalg.norm(m.vertices[pairs[:, 0]] - m.vertices[pairs[:, 1]], axis=1)
        for m in (first, second)
    )
    return float(np.mean(np.abs(two / one - 1)))


def report(shapes: dict[str, Mesh], crossings: dict[str, int], rest: list[Mesh]) -> None:
    for name, mesh in shapes.items():
        assert len(boundary_edges(mesh)) == 0, name
        assert components(mesh).max() == 0, name
    meshes = shapes.values()
    areas = np.array([face_areas(m).min() for m in meshes]) * 1e6
    sides = np.array([edge_lengths(m).min() for m in meshes]) * 1e3
    counts = np.array(list(crossings.values()))
    first = next(iter(meshes))
    print(f"{len(shapes)} shapes, {len(first.vertices)} vertices, {len(first.faces)} faces")
    print(f"smallest triangle {areas.min():.4f} mm², shortest edge {sides.min():.3f} mm")
    print(
        f"self-intersecting pairs of faces: median {np.median(counts):.0f}, "
        f"most {counts.max()} ({max(crossings, key=crossings.__getitem__)}), "
        f"none in {np.sum(counts == 0)}, at most 20 in {np.sum(counts <= 20)}"
    )
    unit_area = [Mesh(m.vertices / np.sqrt(surface_area(m)), m.faces) for m in rest]
    for title, meshes in (("as they are", rest), ("scaled to unit area", unit_area)):
        table = np.array([[distortion(a, b) for b in meshes] for a in meshes])
        pairs = table[~np.eye(len(rest), dtype=bool)]
        print(f"disparity of subjects at rest, {title}: {pairs.min():.3f} to {pairs.max():.3f}")
        print(np.array2string(table, precision=2, floatmode="fixed"))


def draw(axis: Any, mesh: Mesh, *, azimuth: float) -> None:
    """The mesh seen from the front, turned by `azimuth`, painted from back to front."""
    turned = Rotation.from_euler("zx", [azimuth, 8], degrees=True).apply(np.array(mesh.vertices))
    triangles = turned[mesh.faces]
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    order = np.argsort(-triangles.mean(axis=1)[:, 1])
    order = order[normals[order, 1] < 0]
    light = 0.25 + 0.75 * (normals[order] @ unit(np.array([0.4, -0.8, 0.5]))).clip(0)
    colours = light[:, None] * np.array([0.82, 0.78, 0.74])
    axis.add_collection(
        PolyCollection(
            triangles[order][:, :, [0, 2]], facecolors=colours, edgecolors=colours, lw=0.2
        )
    )
    axis.set(xlim=(-0.95, 0.95), ylim=(-0.15, 2.25), aspect="equal")
    axis.axis("off")


# --- the file -------------------------------------------------------------------------------------


def part_labels(bones: list[str], weights: np.ndarray) -> np.ndarray:
    """Number in `PARTS` of the part that moves each vertex most."""
    share = np.zeros((len(weights), len(PARTS)))
    for bone, column in zip(bones, weights.T, strict=True):
        kind = next(part for part, names in PART_BONES.items() if re.match(names, bone))
        side = {"L": "left ", "R": "right "}.get(bone[-1] if "." in bone else "", "")
        name = kind if kind in ("torso", "head") else side + kind
        share[:, PARTS.index(name)] += column
    return share.argmax(axis=1).astype(np.uint8)


@dataclass(frozen=True)
class Skin:
    """The template on the bones of the model: (n, b) weights of the b bones that move it."""

    model: Any
    template: Template
    weights: np.ndarray
    moving: np.ndarray

    def rest(self, phenotype: tuple[float, ...]) -> np.ndarray:
        """Vertices of a symmetric subject at rest, (n, 3)."""
        shape = self.template.means @ rest_shape(self.model, phenotype)
        return (shape + shape[self.template.mirror] * [-1, 1, 1]) / 2

    def bones(self) -> list[str]:
        """Names of the bones that move it."""
        return [b for b, m in zip(self.model.bone_labels, self.moving, strict=True) if m]


def skin() -> Skin:
    """The template and its bones, of the body model."""
    model = anny.Anny(topology="anny-noeyes-notongue", phenotypes="all", skinning_method="lbs").to(
        torch.float64
    )
    template = decimated_template(model)
    full = np.zeros((len(model.template_vertices), model.bone_count))
    np.add.at(
        full,
        (np.arange(len(full))[:, None], model.vertex_bone_indices.numpy()),
        model.vertex_bone_weights.numpy(),
    )
    weights = template.means @ full
    weights /= weights.sum(axis=1, keepdims=True)
    # toes stay as they are at rest: the model's reference pose pushes them into each other
    for bone, label in enumerate(model.bone_labels):
        if label.startswith("toe"):
            weights[:, model.bone_labels.index(f"foot.{label[-1]}")] += weights[:, bone]
            weights[:, bone] = 0
    moving = weights.max(axis=0) > 0
    return Skin(model, template, weights[:, moving], moving)


def least_crossing(
    skin: Skin,
    phenotype: tuple[float, ...],
    draw: Callable[[], dict[str, Rotation]],
    *,
    tries: int,
    enough: int,
) -> tuple[int, np.ndarray, np.ndarray]:
    """Of some draws of a pose, the one with the fewest self-intersections.

    Their number, the motion of the bones, (b, 3, 4), and the vertices, (n, 3), the lowest of them
    on the floor. It stops at a pose with no more than `enough`.
    """
    shape = skin.rest(phenotype)
    found = []
    for _ in range(tries):
        motion = bone_motions(skin.model, phenotype, draw())[skin.moving]
        motion[:, 2, 3] -= skinned(shape, skin.weights, motion)[:, 2].min()  # stand
        points = skinned(shape, skin.weights, motion)
        crossing = self_intersections(Mesh(points, skin.template.faces))
        found.append((crossing, motion, points))
        if crossing <= enough:
            break
    return min(found, key=lambda each: each[0])


def drawn_rotations(
    family: int, random: np.random.Generator, heads: dict[str, np.ndarray], *, weight: float
) -> dict[str, Rotation]:
    """Rotations of the bones in one pose of a family, to the left or the right."""
    side = "L" if random.random() < 0.5 else "R"
    return bone_rotations(eased(draw_pose(family, random), weight=weight), heads, side)


def make(seed: int) -> tuple[Pack, dict[str, int]]:
    """The bodies, and the number of self-intersections of each shape."""
    made = skin()
    spread = sampled(len(made.weights), count=SAMPLES)
    rest, motions, samples, crossings = [], [], [], {}
    for number, (subject, phenotype) in enumerate(SUBJECTS.items()):
        rest.append(made.rest(phenotype))
        heads = joints(made.model, phenotype)
        random = np.random.default_rng([seed, number])
        for family in range(POSES):
            turns = partial(drawn_rotations, family, random, heads, weight=phenotype[3])
            name = f"{subject}_p{family:02d}"
            crossings[name], motion, points = least_crossing(
                made, phenotype, turns, tries=TRIES, enough=8
            )
            motions.append(motion)
            samples.append(points[spread])
            print(name, crossings[name], flush=True)
    pack = Pack(
        rest=np.stack(rest),
        faces=made.template.faces,
        weights=made.weights,
        motions=np.stack(motions).reshape(len(SUBJECTS), POSES, -1, 3, 4),
        mirror=made.template.mirror,
        parts=part_labels(made.bones(), made.weights),
        samples=np.stack(samples).reshape(len(SUBJECTS), POSES, SAMPLES, 3),
    )
    return pack, crossings


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    data = Path(__file__).parents[1] / "src/esd/datasets/data/bodies.npz"
    parser.add_argument("--output", type=Path, default=data)
    parser.add_argument("--sheet", type=Path, help="picture of all bodies to write")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()

    torch.set_num_threads(1)
    pack, crossings = make(options.seed)
    with whole_file(options.output) as path:
        write_pack(pack, path)
    stored = read_pack(options.output)
    places = [(s, p) for s in range(len(SUBJECTS)) for p in range(POSES)]
    points = [posed(stored, subject=s, pose=p) for s, p in places]
    exact = [skinned(pack.rest[s], pack.weights, pack.motions[s, p]) for s, p in places]
    error = np.abs(np.array(points) - np.array(exact)).max()
    print(f"{options.output.stat().st_size / 1e6:.2f} MB, read back within {error * 1e3:.4f} mm")
    shapes = {name: Mesh(x, stored.faces) for name, x in zip(crossings, points, strict=True)}
    report(shapes, crossings, [Mesh(r, stored.faces) for r in stored.rest])
    if options.sheet:
        draw_turned = partial(draw, azimuth=25)
        sheet(
            list(shapes.items()), draw_turned, options.sheet, columns=POSES, size=(2.2, 2.9), dpi=60
        )


if __name__ == "__main__":
    main()
