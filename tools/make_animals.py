"""Generate animals of many builds and poses from a few that are rigged and animated.

    pip install -e .
    python tools/make_animals.py PACK FOLDER --sheet /tmp/animals.png

PACK is a folder of glTF files (`.glb`) whose bones have the names of the *Ultimate Animated Animal
Pack* by Quaternius (CC0, quaternius.com): alpaca, bull, cow, deer, donkey, fox, horse, husky, shiba
inu, stag and wolf. The surface of each is closed and subdivided; legs, neck, trunk, tail, ears and
head are made longer, shorter, thicker or thinner at random; and the animal is posed by a moment of
one of its animations, further turned in each joint. What comes of one animal is registered, and
none with another's. Each shape has triangles of its own. The folder has the layout of
`esd.datasets.export`. The default model is trained on these as well, see `tools/bundle_models.py`.
Equal calls write equal folders.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass, replace
from functools import partial
from itertools import count, islice
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.collections import PolyCollection
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation, Slerp
from sheet import sheet
from trimesh.remesh import subdivide_loop

from esd.common import InputError
from esd.datasets.collection import Collection, Shape
from esd.datasets.export import export_folder
from esd.datasets.remeshing import COARSEST, DENSEST, remeshed_shape
from esd.mesh.geometry import components, face_normals, unit
from esd.mesh.io.gltf import accessor, read_gltf
from esd.mesh.mesh import Mesh
from esd.mesh.repair.repair import repair
from esd.parallel import THIS_PROCESS

STYLES = ("graded", "even", "graded", "stretched", "adaptive", "rough", "graded")
"""Of the triangles of one shape after another, see `esd.mesh.remesh.styles.STYLES`."""

FEET = {"IKFrontLeg": "FrontLowerLeg", "IKBackLeg": "BackLowerLeg"}
"""Bones of feet, which animations place by themselves, and those that they hang on."""

TRUNK = ("Body", "Back", "Torso", "Torso2", "Torso3")
SHINS = ("FrontUpperLeg", "FrontLowerLeg", "BackUpperLeg", "BackLowerLeg")
SHOULDERS = ("FrontShoulder", "BackShoulder")


@dataclass(frozen=True, eq=False)
class Rig:
    """An animal as it is drawn, with its bones.

    Parameters
    ----------
    vertices : (n, 3)
        At rest.
    faces : (m, 3)
    weights : (n, b)
        Shares of the bones in the motion of each vertex.
    names, parents
        Of the bones; -1 for none.
    unbind : (b, 4, 4)
        From rest to the coordinates of each bone.
    document, nodes
        The glTF document, and the node of each bone.
    clips
        Animations by name: for each channel the node, what of it moves, the times and the values.
    """

    name: str
    vertices: np.ndarray
    faces: np.ndarray
    weights: np.ndarray
    names: tuple[str, ...]
    parents: tuple[int, ...]
    unbind: np.ndarray
    document: dict[str, Any]
    nodes: tuple[int, ...]
    clips: dict[str, list[tuple[int, str, np.ndarray, np.ndarray]]]


def read_rig(path: Path) -> Rig:
    """The rig of a file; of several meshes the first that has bones."""
    scene = read_gltf(path)
    document, values = scene.document, partial(accessor, scene.document, scene.buffers)
    if not (document.get("skins") and document.get("animations")):
        raise InputError(f"'{path}' has no skeleton that is animated.")
    skin = document["skins"][0]
    vertices, faces, weights, count = [], [], [], 0
    skinned = (
        mesh["primitives"]
        for mesh in document["meshes"]
        if all("JOINTS_0" in each["attributes"] for each in mesh["primitives"])
    )
    for primitive in next(skinned):
        named = {name: values(number) for name, number in primitive["attributes"].items()}
        share = np.zeros((len(named["POSITION"]), len(skin["joints"])))
        bones = named["JOINTS_0"].astype(int)
        np.add.at(share, (np.arange(len(share))[:, None], bones), named["WEIGHTS_0"])
        vertices.append(named["POSITION"])
        faces.append(values(primitive["indices"]).astype(int).reshape(-1, 3) + count)
        weights.append(share)
        count += len(share)
    drawn = Mesh(np.concatenate(vertices), np.concatenate(faces))
    whole = repair(drawn, together=False).compacted()
    assert isinstance(whole.shape, Mesh)
    # what closes a hole moves as the vertex nearest to it
    near = KDTree(drawn.vertices).query(whole.shape.vertices)[1]
    nodes = tuple(skin["joints"])
    return Rig(
        path.stem,
        whole.shape.vertices,
        whole.shape.faces,
        np.concatenate(weights)[near],
        tuple(document["nodes"][node]["name"] for node in nodes),
        _parents(document, nodes),
        values(skin["inverseBindMatrices"]).reshape(-1, 4, 4).transpose(0, 2, 1),
        document,
        nodes,
        {
            clip["name"].split("|")[-1]: [
                (
                    channel["target"]["node"],
                    channel["target"]["path"],
                    values(clip["samplers"][channel["sampler"]]["input"]).ravel(),
                    values(clip["samplers"][channel["sampler"]]["output"]),
                )
                for channel in clip["channels"]
            ]
            for clip in document["animations"]
        },
    )


def subdivided(rig: Rig) -> Rig:
    """The animal with four triangles for each, smoothed; weights as well (Loop 1987)."""
    vertices, faces = subdivide_loop(rig.vertices, rig.faces, iterations=1)
    columns = np.pad(rig.weights, ((0, 0), (0, -rig.weights.shape[1] % 3)))
    weights = [
        subdivide_loop(part, rig.faces, iterations=1)[0]
        for part in np.split(columns, columns.shape[1] // 3, axis=1)
    ]
    shares = np.concatenate(weights, axis=1)[:, : rig.weights.shape[1]]
    shares = shares / shares.sum(axis=1, keepdims=True)
    return replace(rig, vertices=vertices, faces=faces, weights=shares)


def _parents(document: dict[str, Any], nodes: tuple[int, ...]) -> tuple[int, ...]:
    """The bone that each hangs on, feet on their legs."""
    names = [document["nodes"][node]["name"] for node in nodes]
    above = {
        child: place
        for place, node in enumerate(document["nodes"])
        for child in node.get("children", [])
    }
    found = []
    for node, name in zip(nodes, names, strict=True):
        stem, _, side = name.partition(".")
        if stem in FEET:
            found.append(names.index(f"{FEET[stem]}.{side}"))
        else:
            found.append(nodes.index(above[node]) if above.get(node) in nodes else -1)
    return tuple(found)


def bone_motions(rig: Rig, clip: str, moment: float) -> np.ndarray:
    """Where each bone is, (b, 4, 4), at a moment between 0 and 1 of an animation."""
    nodes = rig.document["nodes"]
    place = [np.array(node.get("translation", [0.0, 0.0, 0.0])) for node in nodes]
    turn = [Rotation.from_quat(node.get("rotation", [0, 0, 0, 1])) for node in nodes]
    size = [np.array(node.get("scale", [1.0, 1.0, 1.0])) for node in nodes]
    for node, path, times, values in rig.clips[clip]:
        time = times[0] + moment * (times[-1] - times[0])
        if path == "rotation":
            turns = Rotation.from_quat(values)
            turn[node] = Slerp(times, turns)(time) if len(times) > 1 else turns[0]
        elif path in ("translation", "scale"):
            now = np.array([np.interp(time, times, column) for column in values.T])
            (place if path == "translation" else size)[node] = now
    above = {child: i for i, node in enumerate(nodes) for child in node.get("children", [])}

    def motion(node: int) -> np.ndarray:
        own = np.eye(4)
        own[:3, :3], own[:3, 3] = turn[node].as_matrix() * size[node], place[node]
        return motion(above[node]) @ own if node in above else own

    return np.stack([motion(node) for node in rig.nodes])


def build(random: np.random.Generator, names: tuple[str, ...]) -> np.ndarray:
    """How much longer and thicker each bone is than drawn, (b, 3): thick, long, thick."""

    def u(low: float, high: float) -> float:
        return float(np.exp(random.uniform(low, high)))

    def n(deviation: float) -> float:
        return float(np.exp(random.normal(0, deviation)))

    leg, shin = u(-0.75, 0.25), u(-0.25, 0.7)  # length, thickness
    fat, tall, trunk = u(-0.25, 0.5), n(0.12), n(0.15)
    neck, nape = u(-0.5, 0.35), u(-0.2, 0.5)
    head, muzzle, ear = u(-0.25, 0.4), n(0.18), u(-0.8, 0.2)
    tail, brush = u(-1.0, 0.7), u(-0.5, 0.4)

    def sizes(name: str) -> tuple[float, float, float]:
        stem = name.partition(".")[0]
        if stem.startswith("Tail"):
            return brush, tail, brush
        if stem.startswith("Ear"):
            return ear, ear, ear
        if stem == "Head":
            return head, head * muzzle, head
        if stem.startswith("Neck"):
            return nape, neck, nape
        if stem in TRUNK:
            return fat, trunk, fat * tall
        if stem in SHOULDERS:
            return 1.0, 1.0, 1.0
        if stem in SHINS:
            return shin, leg, shin
        if stem == "BackLeg":  # the thigh, mostly within the trunk
            return shin**0.5, leg**0.4, shin**0.5
        return shin**0.9, (shin * leg) ** 0.5, shin**0.9  # feet

    return np.array([sizes(name) for name in names])


def wiggle(random: np.random.Generator, names: tuple[str, ...]) -> list[Rotation]:
    """A turn of each bone at random, mostly about its own first axis."""

    def deviation(name: str) -> float:
        stem = name.partition(".")[0]
        if stem.startswith(("Tail", "Ear")):
            return 0.3
        if stem.startswith("Neck") or stem == "Head":
            return 0.2
        if "Leg" in stem and stem not in FEET:
            return 0.22
        return 0.1 if stem.startswith("Torso") else 0.0

    scale = np.array([1.0, 0.4, 0.5])
    return [Rotation.from_rotvec(deviation(n) * scale * random.normal(size=3)) for n in names]


def posed(rig: Rig, motions: np.ndarray, sizes: np.ndarray, turns: list[Rotation]) -> np.ndarray:
    """The vertices of an animal of another build, (n, 3), by linear blend skinning."""
    own: dict[int, np.ndarray] = {}

    def motion(bone: int) -> np.ndarray:
        if bone not in own:
            parent = rig.parents[bone]
            relative = motions[bone]
            if parent >= 0:
                relative = np.linalg.inv(motions[parent]) @ relative
                relative[:3, 3] *= sizes[parent]  # it hangs at the end of a longer bone
            turn = np.eye(4)
            turn[:3, :3] = turns[bone].as_matrix()
            own[bone] = (motion(parent) if parent >= 0 else np.eye(4)) @ relative @ turn
        return own[bone]

    rows = np.hstack([rig.vertices, np.ones((len(rig.vertices), 1))])
    moved = np.zeros_like(rig.vertices)
    for bone in np.flatnonzero(rig.weights.max(axis=0) > 0):
        matrix = motion(bone) @ np.diag([*sizes[bone], 1.0]) @ rig.unbind[bone]
        moved += rig.weights[:, [bone]] * (rows @ matrix.T)[:, :3]
    return moved


def drawn(rig: Rig, name: str, seed: tuple[int, ...]) -> Shape | None:
    """An animal of some build, in some pose; None if remeshing it leaves more than one piece."""
    random = np.random.default_rng(seed)
    clip = list(rig.clips)[random.integers(len(rig.clips))]
    motions = bone_motions(rig, clip, random.uniform())
    sizes, turns = build(random, rig.names), wiggle(random, rig.names)
    mesh, points = Mesh(posed(rig, motions, sizes, turns), rig.faces), np.arange(len(rig.vertices))
    shape = Shape(
        name=name,
        subject=name,
        template=rig.name.lower(),
        mesh=lambda: mesh,
        correspondence=lambda: points,
    )
    vertices = round(COARSEST * (DENSEST / COARSEST) ** random.random())
    style = STYLES[sum(seed) % len(STYLES)]
    made = remeshed_shape(shape, vertex_count=vertices, style=style, seed=seed[-1])
    return made if components(made.mesh()).max() == 0 else None


def animals(rigs: list[Rig], *, builds: int, seed: int) -> Collection:
    """Each animal in some builds and poses, remeshed."""
    shapes: list[Shape] = []
    for number, rig in enumerate(rigs):
        found = (
            drawn(rig, f"{rig.name.lower()}_{place:02d}", (seed, number, place))
            for place in count()
        )
        shapes += islice((shape for shape in found if shape is not None), builds)
    return Collection("animals", tuple(shapes))


def draw(axis: Any, mesh: Mesh) -> None:
    """The mesh seen from the side, painted from back to front."""
    side = Rotation.from_euler("y", 0.6).as_matrix()
    mesh = Mesh(mesh.vertices @ side.T, mesh.faces)
    corners = mesh.vertices[mesh.faces]
    order = np.argsort(corners[:, :, 0].mean(axis=1))
    light = np.clip(unit(face_normals(mesh)) @ [0.8, 0.5, 0.2], 0, 1)[order]
    flat = np.stack([-corners[order][:, :, 2], corners[order][:, :, 1]], axis=-1)
    shades = np.repeat(0.25 + 0.7 * light[:, None], 3, axis=1)
    axis.add_collection(PolyCollection(flat, facecolors=shades))
    axis.autoscale()
    axis.set_aspect("equal")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("pack", type=Path)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--builds", type=int, default=22, help="of each animal")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--sheet", type=Path, help="picture of the shapes to write")
    options = parser.parse_args()

    files = sorted(options.pack.glob("*.glb"))
    if not files:
        parser.error(f"'{options.pack}' holds no .glb files")
    try:
        rigs = [subdivided(read_rig(path)) for path in files if path.stem != "Horse_White"]
    except InputError as error:
        sys.exit(str(error))
    collection = animals(rigs, builds=options.builds, seed=options.seed)
    export_folder(collection, options.folder, suffix=".ply", workers=THIS_PROCESS)
    if options.sheet:
        shapes = [(shape.name, shape.mesh()) for shape in collection.shapes]
        sheet(shapes, draw, options.sheet, columns=12, size=(2, 1.8), dpi=60)


if __name__ == "__main__":
    main()
