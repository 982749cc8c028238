"""Registrations of one body template to the people of FAUST_r, beside fits without the map.

    python benchmarks/registration.py ../shared/data/faust_r --scans 60-79

prints a line for each scan and the means. Lengths are in % of the scan's longest extent. The error
of a vertex is its distance to the true vertex; that of the map, the same of the matched vertex.
'points only' starts from the same rigid alignment and has nearest points instead of the map.

    python benchmarks/registration.py ../shared/data/faust_r --scans 60,66,72,76 --peers

compares with other packages' fits along the same maps: `trimesh.registration.nricp_amberg` and
`nricp_sumner`, with their default steps, and libigl's as-rigid-as-possible deformation. All
take matches as landmarks: those of 300 vertices spread over the template, and of the most confident
half of these. Seconds are of the processor.

    python benchmarks/registration.py ../shared/data/faust_r --partial

cuts parts off eight of the scans and prints, for each, the errors of the vertices where the scan
has something, beside those of the map and of nearest points alone, and where it has nothing; there
also the share of vertices that the map leaves unmatched, and that are said to be supported. Limbs
are cut off at a geodesic distance from the tip of the hand or foot, in shares of the longest
extent; other cuts are those of `esd.datasets.parts`.

    python benchmarks/registration.py --animation 10

registers a body that ships with the package to frames of another one, remeshed each on its own,
whose bones turn evenly from one pose to another: as a sequence, and each frame by itself.
"""

from __future__ import annotations

import argparse
import time
from functools import partial
from importlib import resources
from pathlib import Path

import numpy as np
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation, Slerp

import esd
from esd.datasets.body_pack import posed, read_pack, skinned
from esd.datasets.folder import read_vts
from esd.datasets.parts import Perturbed, part_of, part_with
from esd.deformation.fit import Fit, fit, is_inverted
from esd.mesh.geodesics import geodesic_graph
from esd.mesh.geometry import surface_area
from esd.mesh.mesh import Mesh
from esd.mesh.remesh.remesh import remesh
from esd.mesh.sampling import spread
from esd.registration.quality import distance_to, quality


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, nargs="?")
    parser.add_argument("--template", default="tr_reg_000")
    parser.add_argument("--scans", default="60-79", help="numbers, or the first and the last")
    parser.add_argument("--peers", action="store_true")
    parser.add_argument("--partial", action="store_true")
    parser.add_argument("--animation", type=int, metavar="FRAMES", help="of the bodies, instead")
    arguments = parser.parse_args()
    if arguments.animation:
        of_animation(arguments.animation)
        return
    if arguments.partial:
        of_parts(arguments)
        return
    if "-" in arguments.scans:
        first, last = map(int, arguments.scans.split("-"))
        numbers = list(range(first, last + 1))
    else:
        numbers = [int(number) for number in arguments.scans.split(",")]
    (beside_peers if arguments.peers else beside_points)(arguments, numbers)


def of_animation(count: int, *, subject: int = 5, pose: int = 3) -> None:
    with resources.as_file(resources.files("esd.datasets") / "data" / "bodies.npz") as path:
        pack = read_pack(path)
    template = Mesh(posed(pack, subject=0, pose=0), pack.faces)
    ends = pack.motions[subject, 0], pack.motions[subject, pose]
    # bones turn evenly, and the centre of what each moves goes straight
    weight = pack.weights / np.maximum(pack.weights.sum(axis=0), 1e-12)
    centre = weight.T @ pack.rest[subject]
    turns = [
        Slerp([0, 1], Rotation.from_matrix([a, b]))
        for a, b in zip(*(e[:, :, :3] for e in ends), strict=True)
    ]
    moved = [np.einsum("bij,bj->bi", e[:, :, :3], centre) + e[:, :, 3] for e in ends]
    truths, frames = [], []
    for number, share in enumerate(np.linspace(0, 1, count)):
        turn = np.stack([each(share).as_matrix() for each in turns])
        shift = (1 - share) * moved[0] + share * moved[1] - np.einsum("bij,bj->bi", turn, centre)
        motion = np.concatenate([turn, shift[:, :, None]], axis=2)
        truths.append(skinned(pack.rest[subject], pack.weights, motion))
        frames.append(remesh(Mesh(truths[-1], pack.faces), 5000, seed=number).mesh)
    alone = (esd.register(template, frame) for frame in frames)
    for label, found in (
        ("sequence", esd.register_sequence(template, frames)),
        ("each frame alone", alone),
    ):
        start = time.process_time()
        rows = [
            (
                error(each.mesh.vertices, truth) / each.quality.extent,
                each.quality.relative_distance,
                each.quality.inverted / 100,
                each.match is not None,
            )
            for each, truth in zip(found, truths, strict=True)
        ]
        seconds = (time.process_time() - start) / count
        by_map = [number for number, row in enumerate(rows) if row[3]]
        errors = " ".join(f"{100 * row[0]:.2f}" for row in rows)
        means = " | ".join(f"{100 * value:.3f}" for value in np.mean(rows, axis=0)[:3])
        print(
            f"{label}: error | distance | inverted faces, means: {means}; {seconds:.1f} s a frame"
        )
        print(f"  error of each frame: {errors}; along a map: {by_map}", flush=True)


def beside_peers(arguments: argparse.Namespace, numbers: list[int]) -> None:
    template = esd.read_mesh(arguments.folder / "shapes" / f"{arguments.template}.off")
    here = read_vts(arguments.folder / "corres" / f"{arguments.template}.vts")
    print("fit | scan | distance | error | inverted | s")
    for number in numbers:
        name = f"tr_reg_{number:03d}"
        scan = esd.read_mesh(arguments.folder / "shapes" / f"{name}.off")
        there = read_vts(arguments.folder / "corres" / f"{name}.vts")
        match = esd.match(template, scan, mirror="no")
        extent = np.ptp(scan.vertices, axis=0).max()
        for label, deform in PEERS.items():
            start = time.process_time()
            vertices = deform(template, scan, match)
            seconds = time.process_time() - start
            gap = distance_to(scan, vertices).mean() / extent
            missed = error(vertices[here], scan.vertices[there]) / extent
            count = int(is_inverted(Mesh(vertices, template.faces)).sum())
            figures = f"{100 * gap:.3f} | {100 * missed:.3f} | {count} | {seconds:.1f}"
            print(label, name, figures, sep=" | ", flush=True)


def ours(template: Mesh, scan: Mesh, match: esd.Correspondence) -> np.ndarray:
    return esd.register(template, scan, correspondence=match).mesh.vertices


def trimesh_nricp(kind: str, template: Mesh, scan: Mesh, match: esd.Correspondence) -> np.ndarray:
    import trimesh

    marks = landmarks(template, match)
    meshes = [trimesh.Trimesh(m.vertices, m.faces, process=False) for m in (template, scan)]
    register = getattr(trimesh.registration, kind)
    places = scan.vertices[match.target_index[marks]]
    return np.asarray(register(*meshes, source_landmarks=marks, target_positions=places))


def igl_arap(template: Mesh, scan: Mesh, match: esd.Correspondence) -> np.ndarray:
    import igl

    marks = landmarks(template, match)
    images = scan.vertices[match.target_index[marks]]
    data = igl.ARAPData()
    data.energy = igl.ARAP_ENERGY_TYPE_SPOKES_AND_RIMS
    data.max_iter = 100
    igl.arap_precomputation(template.vertices, template.faces, 3, marks.astype(np.int32), data)
    return np.asarray(igl.arap_solve(images, data, scan.vertices[match.target_index]))


LEG, OTHER_LEG, ARM, OTHER_ARM = 0, 1, 2, 3
CUTS = {  # number of the scan, and limbs with lengths or a kind of part with a seed
    "leg": (60, [(LEG, 0.42)]),
    "other leg": (63, [(OTHER_LEG, 0.42)]),
    "arm": (65, [(ARM, 0.30)]),
    "shank and forearm": (72, [(OTHER_LEG, 0.25), (OTHER_ARM, 0.2)]),
    "cut of 20 %": (76, 3),
    "cut of 35 %": (78, 1),
    "view": (66, 0),
    "view, other side": (74, 1),
}


def of_parts(arguments: argparse.Namespace) -> None:
    template = esd.read_mesh(arguments.folder / "shapes" / f"{arguments.template}.off")
    here = read_vts(arguments.folder / "corres" / f"{arguments.template}.vts")
    print(
        "part | area, % | there: map | error | points only | missing: unmatched, % | supported, % "
        "| error | points only | distance | inverted | verdict"
    )
    for label, (number, cut) in CUTS.items():
        name = f"tr_reg_{number:03d}"
        whole = esd.read_mesh(arguments.folder / "shapes" / f"{name}.off")
        there = read_vts(arguments.folder / "corres" / f"{name}.vts")
        if isinstance(cut, int):
            part = part_of(whole, label.partition(",")[0], seed=cut)
        else:
            part = without_limbs(whole, there[limb_tips(template, here)], cut)
        scan, extent = part.mesh, np.ptp(whole.vertices, axis=0).max()
        match = esd.match(template, scan, mirror="no")
        found = esd.register(template, scan, correspondence=match)
        alone = points_only(template, scan, match.target_index)
        true, index = whole.vertices[there], match.target_index[here]
        present = part.vertex_index[there] >= 0
        matched = present & (index >= 0)
        gaps = [
            np.linalg.norm(points - true, axis=1) / extent
            for points in (scan.vertices[index], found.mesh.vertices[here], alone.vertices[here])
        ]
        row = (
            surface_area(scan) / surface_area(whole),
            gaps[0][matched].mean(),
            *(gap[present].mean() for gap in gaps[1:]),
            (index[~present] < 0).mean(),
            found.supported[here[~present]].mean(),
            *(gap[~present].mean() for gap in gaps[1:]),
            found.quality.relative_distance,
        )
        figures = " | ".join(f"{100 * value:.2f}" for value in row)
        verdict = match.judgement.verdict if match.judgement else ""
        print(label, figures, found.quality.inverted, verdict, sep=" | ", flush=True)


def limb_tips(mesh: Mesh, rows: np.ndarray) -> np.ndarray:
    """Which of the rows are the tips of both legs and both arms of an upright body, y up.

    The vertices farthest from the middle and from each other are these and the top of the head.
    """
    graph = geodesic_graph(mesh)
    middle = mesh.vertices.mean(axis=0)
    tips = [int(np.linalg.norm(mesh.vertices - middle, axis=1).argmin())]
    for _ in range(5):
        tips.append(int(graph.distances_to_any(np.array(tips)).argmax()))
    by_height = sorted(tips[1:], key=lambda tip: mesh.vertices[tip, 1])  # feet, hands, head
    pairs = [
        sorted(pair, key=lambda tip: -mesh.vertices[tip, 0])
        for pair in (by_height[:2], by_height[2:4])
    ]
    return KDTree(mesh.vertices[rows]).query(mesh.vertices[np.concatenate(pairs)])[1]


def without_limbs(mesh: Mesh, tips: np.ndarray, limbs: list[tuple[int, float]]) -> Perturbed:
    graph, extent = geodesic_graph(mesh), np.ptp(mesh.vertices, axis=0).max()
    gone = np.zeros(len(mesh.vertices), dtype=bool)
    for limb, share in limbs:
        gone |= graph.distances_to_any(tips[limb : limb + 1]) < share * extent
    return part_with(mesh, ~gone[mesh.faces].any(axis=1))


def landmarks(template: Mesh, match: esd.Correspondence) -> np.ndarray:
    """The more confident half of 300 vertices that are spread over the template."""
    chosen = spread(template.vertices, LANDMARKS)
    return np.sort(chosen[np.argsort(-match.confidence[chosen])[: LANDMARKS // 2]])


LANDMARKS = 300
PEERS = {
    "esd": ours,
    "trimesh nricp_amberg": partial(trimesh_nricp, "nricp_amberg"),
    "trimesh nricp_sumner": partial(trimesh_nricp, "nricp_sumner"),
    "libigl arap": igl_arap,
}


def beside_points(arguments: argparse.Namespace, numbers: list[int]) -> None:
    template = esd.read_mesh(arguments.folder / "shapes" / f"{arguments.template}.off")
    here = read_vts(arguments.folder / "corres" / f"{arguments.template}.vts")
    print("scan | distance | error | of the map | inverted | points only: distance | error | s")
    rows = []
    for number in numbers:
        name = f"tr_reg_{number:03d}"
        scan = esd.read_mesh(arguments.folder / "shapes" / f"{name}.off")
        there = read_vts(arguments.folder / "corres" / f"{name}.vts")
        match = esd.match(template, scan, mirror="no")
        start = time.process_time()
        found = esd.register(template, scan, correspondence=match)
        seconds = time.process_time() - start
        extent = found.quality.extent
        true = scan.vertices[there]
        alone = points_only(template, scan, match.target_index)
        row = [
            found.quality.relative_distance,
            error(found.mesh.vertices[here], true) / extent,
            error(scan.vertices[match.target_index[here]], true) / extent,
            found.quality.inverted / 100,
            quality(template, scan, alone).relative_distance,
            error(alone.vertices[here], true) / extent,
            seconds / 100,
        ]
        rows.append(row)
        print(name, *(f"{100 * value:.3f}" for value in row), sep=" | ", flush=True)
    print("mean", *(f"{100 * value:.3f}" for value in np.mean(rows, axis=0)), sep=" | ")


def error(points: np.ndarray, true: np.ndarray) -> float:
    """Mean distance of corresponding points."""
    return float(np.linalg.norm(points - true, axis=1).mean())


def points_only(template: Mesh, scan: Mesh, target_index: np.ndarray) -> Fit:
    """The template fitted to nearest points alone, from the rigid alignment that the map gives."""
    from scipy.spatial.transform import Rotation

    matched = target_index >= 0
    before, after = template.vertices[matched], scan.vertices[target_index[matched]]
    rotation, _ = Rotation.align_vectors(after - after.mean(axis=0), before - before.mean(axis=0))
    start = rotation.apply(template.vertices - before.mean(axis=0)) + after.mean(axis=0)
    none = np.full(len(start), -1)
    return fit(template, scan, none, np.zeros(len(none)), start=start)


if __name__ == "__main__":
    main()
