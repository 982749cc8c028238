"""Blender add-on: weights, UVs and shape keys of one mesh on another, along a map by `esd`.

Install this file by Edit › Preferences › Add-ons › Install from Disk. `esd` itself is installed in
a Python of its own, which the preferences of the add-on name; it is run as a process, and Blender's
Python stays as it is.
"""

import json
import os
import struct
import subprocess
import tempfile
import zlib
from pathlib import Path

import bpy
import numpy as np

bl_info = {
    "name": "Dense correspondence (esd)",
    "author": "The esd developers",
    "version": (1, 0, 0),
    "blender": (3, 6, 0),
    "location": "View3D > Object > Transfer by Correspondence",
    "description": "Transfers weights, UVs and shape keys between meshes of different topology",
    "category": "Object",
}

LEAST_WEIGHT = 1e-4  # a vertex of less is not in the group


class TransferError(Exception):
    """What went wrong, in a line for the user."""


def run_esd(python: str, *arguments: str | Path) -> str:
    """What a command of `esd` prints; raises `TransferError` with its last line if it fails."""
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONHOME"}  # that of Blender
    command = [bpy.path.abspath(python), "-m", "esd", *map(str, arguments)]
    try:
        done = subprocess.run(command, capture_output=True, text=True, env=environment)
    except OSError as error:
        raise TransferError(
            f"'{python}' cannot be run: {error.strerror}. Name the Python that has esd in the "
            "preferences of the add-on."
        ) from error
    if done.returncode != 0:
        lines = (done.stderr or done.stdout).strip().splitlines() or ["no message"]
        raise TransferError(f"esd {arguments[0]}: {lines[-1]}")
    return done.stdout


def vertices_of(mesh: bpy.types.Mesh) -> np.ndarray:
    """Positions of the vertices, (n, 3), without shape keys other than the basis."""
    keys = mesh.shape_keys
    points = keys.reference_key.data if keys else mesh.vertices
    found = np.empty(3 * len(points), dtype=np.float32)
    points.foreach_get("co", found)
    return found.reshape(-1, 3).astype(float)


def triangles_of(mesh: bpy.types.Mesh) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and loops at the corners of the triangles, (m, 3) each."""
    mesh.calc_loop_triangles()
    found = [np.empty(3 * len(mesh.loop_triangles), dtype=np.int32) for _ in range(2)]
    mesh.loop_triangles.foreach_get("vertices", found[0])
    mesh.loop_triangles.foreach_get("loops", found[1])
    return found[0].reshape(-1, 3), found[1].reshape(-1, 3)


def write_off(vertices: np.ndarray, faces: np.ndarray, path: Path) -> None:
    """Write a mesh as OFF."""
    lines = ["OFF", f"{len(vertices)} {len(faces)} 0"]
    lines += [" ".join(map(repr, vertex)) for vertex in vertices.tolist()]
    lines += ["3 " + " ".join(map(str, face)) for face in faces.tolist()]
    path.write_text("\n".join([*lines, ""]), encoding="ascii")


def weights_of(thing: bpy.types.Object) -> np.ndarray:
    """Weights of all vertices in all groups, (n, g)."""
    weights = np.zeros((len(thing.data.vertices), len(thing.vertex_groups)))
    for vertex in thing.data.vertices:
        for member in vertex.groups:
            weights[vertex.index, member.group] = member.weight
    return weights


def set_weights(thing: bpy.types.Object, names: list[str], weights: np.ndarray) -> None:
    """Replace the groups of these names by weights (n, g); a NaN is no member."""
    for name, column in zip(names, weights.T, strict=True):
        old = thing.vertex_groups.get(name)
        if old is not None:
            thing.vertex_groups.remove(old)
        group = thing.vertex_groups.new(name=name)
        for index in np.flatnonzero(column > LEAST_WEIGHT).tolist():
            group.add([index], float(min(column[index], 1.0)), "REPLACE")


def keys_of(mesh: bpy.types.Mesh) -> tuple[list[str], np.ndarray]:
    """Names of the shape keys besides the basis, and positions in them (k, n, 3)."""
    names, positions = [], []
    for key in mesh.shape_keys.key_blocks if mesh.shape_keys else ():
        if key != mesh.shape_keys.reference_key:
            found = np.empty(3 * len(mesh.vertices), dtype=np.float32)
            key.data.foreach_get("co", found)
            names.append(key.name)
            positions.append(found.reshape(-1, 3))
    return names, np.array(positions, dtype=float).reshape(len(names), -1, 3)


def local_rotations(here: np.ndarray, there: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Rotations (n, 3, 3) that turn the surface around points to that around their images.

    Of edges at each vertex and its neighbours (Kabsch 1976), twice averaged.
    """
    start, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    start, end = np.concatenate([start, end]), np.concatenate([end, start])
    products = np.einsum("ei,ej->eij", here[end] - here[start], there[end] - there[start])
    products[~np.isfinite(products).all(axis=(1, 2))] = 0
    covariance = np.zeros((len(here), 3, 3))
    np.add.at(covariance, start, products)
    for _ in range(2):
        wider = covariance.copy()
        np.add.at(wider, start, covariance[end])
        covariance = wider
    left, _, right = np.linalg.svd(covariance)
    flip = np.linalg.det(np.einsum("nij,njk->nik", left, right)) < 0
    left[flip, :, 2] *= -1
    return np.einsum("nji,nkj->nik", right, left)


def area(vertices: np.ndarray, faces: np.ndarray) -> float:
    """Area of a mesh."""
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)


def set_keys(
    thing: bpy.types.Object, names: list[str], offsets: np.ndarray, points: np.ndarray
) -> None:
    """Replace the shape keys of these names by offsets (k, n, 3) from points (n, 3)."""
    if thing.data.shape_keys is None:
        thing.shape_key_add(name="Basis", from_mix=False)
    for name, offset in zip(names, offsets, strict=True):
        old = thing.data.shape_keys.key_blocks.get(name)
        if old is not None:
            thing.shape_key_remove(old)
        key = thing.shape_key_add(name=name, from_mix=False)
        moved = points + np.nan_to_num(offset)
        key.data.foreach_set("co", moved.astype(np.float32).ravel())


def write_textured(mesh: bpy.types.Mesh, vertices: np.ndarray, path: Path) -> None:
    """Write an OBJ file with the active UVs and an image of one pixel, which `esd` asks for."""
    faces, loops = triangles_of(mesh)
    flat = np.empty(2 * len(mesh.loops), dtype=np.float32)
    mesh.uv_layers.active.data.foreach_get("uv", flat)
    lines = [f"mtllib {path.stem}.mtl", "usemtl uv"]
    lines += ["v " + " ".join(map(repr, vertex)) for vertex in vertices.tolist()]
    lines += [f"vt {u!r} {v!r}" for u, v in flat.reshape(-1, 2).tolist()]
    corners = zip((faces + 1).tolist(), (loops + 1).tolist(), strict=True)
    lines += ["f " + " ".join(f"{v}/{t}" for v, t in zip(*face, strict=True)) for face in corners]
    path.write_text("\n".join([*lines, ""]), encoding="ascii")
    path.with_suffix(".mtl").write_text(f"newmtl uv\nmap_Kd {path.stem}.png\n", encoding="ascii")

    def chunk(name: bytes, data: bytes) -> bytes:
        check = zlib.crc32(name + data)
        return struct.pack(">I", len(data)) + name + data + struct.pack(">I", check)

    pixel = chunk(b"IHDR", struct.pack(">IIBBBBB", 1, 1, 8, 2, 0, 0, 0))
    pixel += chunk(b"IDAT", zlib.compress(b"\0\x80\x80\x80")) + chunk(b"IEND", b"")
    path.with_suffix(".png").write_bytes(b"\x89PNG\r\n\x1a\n" + pixel)


def set_uvs(mesh: bpy.types.Mesh, name: str, path: Path) -> None:
    """Replace the UV layer of a name by the coordinates in an OBJ file of the same vertices."""
    places: list[list[float]] = []
    at_corner: dict[tuple[int, ...], dict[int, int]] = {}  # by the vertices of the face
    for line in path.read_text(encoding="ascii").splitlines():
        words = line.split()
        if words[:1] == ["vt"]:
            places.append([float(words[1]), float(words[2])])
        elif words[:1] == ["f"]:
            # OBJ counts from 1
            corners = {
                int(v) - 1: int(t) - 1 for v, t in (word.split("/")[:2] for word in words[1:])
            }
            at_corner[tuple(sorted(corners))] = corners
    uvs = np.zeros((len(mesh.loops), 2), dtype=np.float32)
    for vertices, loops in zip(*(array.tolist() for array in triangles_of(mesh)), strict=True):
        corners = at_corner.get(tuple(sorted(vertices)), {})
        for vertex, loop in zip(vertices, loops, strict=True):
            if vertex in corners:
                uvs[loop] = places[corners[vertex]]
    layer = mesh.uv_layers.get(name) or mesh.uv_layers.new(name=name)
    layer.data.foreach_set("uv", uvs.ravel())


def transfer(
    source: bpy.types.Object,
    target: bpy.types.Object,
    python: str,
    *,
    weights: bool = True,
    uvs: bool = True,
    keys: bool = True,
    map_file: str = "",
) -> tuple[list[str], str]:
    """Transfer data from one object to another along a map, by default one that `esd` computes.

    Returns what was transferred, and the verdict on the map: good, doubtful or failed; empty for
    a map from a file.
    """
    if source.data == target.data:
        raise TransferError("Both objects share one mesh: there is nothing to transfer.")
    here, there = vertices_of(source.data), vertices_of(target.data)
    faces, target_faces = triangles_of(source.data)[0], triangles_of(target.data)[0]
    groups = [group.name for group in source.vertex_groups] if weights else []
    key_names, key_positions = keys_of(source.data) if keys else ([], np.zeros((0, len(here), 3)))
    layer = source.data.uv_layers.active if uvs else None
    if not groups and not key_names and layer is None:
        raise TransferError(f"'{source.name}' has nothing of what is to be transferred.")
    done, verdict = [], ""
    with tempfile.TemporaryDirectory(prefix="esd-") as name:
        folder = Path(name)
        files = folder / "source.off", folder / "target.off", folder / "map.csv"
        write_off(here, faces, files[0])
        write_off(there, target_faces, files[1])
        if map_file:
            files = *files[:2], Path(bpy.path.abspath(map_file))
        else:
            summary = run_esd(python, "match", *files[:2], "-o", files[2], "--json", "--quiet")
            verdict = json.loads(summary)["verdict"] or ""
        if groups or key_names:
            columns = [weights_of(source)[:, : len(groups)], here, *key_positions]
            np.save(folder / "values.npy", np.concatenate(columns, axis=1))
            values = ("--values", folder / "values.npy", "-o", folder / "carried.npy")
            run_esd(python, "transfer", *files, *values)
            carried = np.load(folder / "carried.npy")
            found, places = np.split(carried, [len(groups)], axis=1)
            if groups:
                set_weights(target, groups, found)
                done.append(f"{len(groups)} vertex groups")
            if key_names:
                # places on the source in its basis and in each key; offsets turn with the surface
                basis, *moved = np.split(places, 1 + len(key_names), axis=1)
                turn = local_rotations(basis, there, target_faces)
                scale = np.sqrt(area(there, target_faces) / area(here, faces))
                offsets = [scale * np.einsum("nij,nj->ni", turn, key - basis) for key in moved]
                set_keys(target, key_names, np.array(offsets), there)
                done.append(f"{len(key_names)} shape keys")
        if layer is not None:
            write_textured(source.data, here, folder / "textured.obj")
            files = folder / "textured.obj", files[1], files[2]
            run_esd(python, "transfer", *files, "--texture", "-o", folder / "carried.obj")
            set_uvs(target.data, layer.name, folder / "carried.obj")
            done.append("UVs")
    return done, verdict


class ESD_Preferences(bpy.types.AddonPreferences):
    """Where `esd` is installed."""

    bl_idname = __name__

    python: bpy.props.StringProperty(  # type: ignore[valid-type]
        name="Python with esd",
        description="The python in whose environment esd was installed",
        subtype="FILE_PATH",
        default="python3",
    )

    def draw(self, context: bpy.types.Context) -> None:
        """Show the setting."""
        self.layout.prop(self, "python")


class ESD_OT_transfer(bpy.types.Operator):
    """Transfer weights, UVs and shape keys from the active mesh to the other selected one."""

    bl_idname = "object.esd_transfer"
    bl_label = "Transfer by Correspondence"
    bl_options = {"REGISTER", "UNDO"}

    weights: bpy.props.BoolProperty(name="Vertex groups", default=True)  # type: ignore[valid-type]
    uvs: bpy.props.BoolProperty(name="Active UVs", default=True)  # type: ignore[valid-type]
    keys: bpy.props.BoolProperty(name="Shape keys", default=True)  # type: ignore[valid-type]
    map_file: bpy.props.StringProperty(  # type: ignore[valid-type]
        name="Map",
        description="A map from the active mesh to the other, as esd match and the studio write "
        "it; the meshes are matched if there is none",
        subtype="FILE_PATH",
        options={"SKIP_SAVE"},
    )
    python: bpy.props.StringProperty(  # type: ignore[valid-type]
        name="Python", description="By default that of the preferences", options={"SKIP_SAVE"}
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Whether two meshes are selected, one of them active, in object mode."""
        chosen = [thing for thing in context.selected_objects if thing.type == "MESH"]
        return context.mode == "OBJECT" and len(chosen) == 2 and context.active_object in chosen

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Ask what to transfer."""
        return context.window_manager.invoke_props_dialog(self)

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Transfer it."""
        source = context.active_object
        (target,) = (
            thing
            for thing in context.selected_objects
            if thing != source and thing.type == "MESH"  # a rig may be selected, too
        )
        addon = context.preferences.addons.get(__name__)
        python = self.python or (addon.preferences.python if addon else "python3")
        try:
            chosen = {"weights": self.weights, "uvs": self.uvs, "keys": self.keys}
            done, verdict = transfer(source, target, python, map_file=self.map_file, **chosen)
        except TransferError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        line = f"Transferred {', '.join(done)} to '{target.name}'."
        if verdict in ("", "good"):
            self.report({"INFO"}, line)
        else:
            self.report({"WARNING"}, f"{line} The map is {verdict}: look at it in esd studio.")
        return {"FINISHED"}


def _menu(self: bpy.types.Menu, context: bpy.types.Context) -> None:
    self.layout.operator(ESD_OT_transfer.bl_idname)


def register() -> None:
    """Add the operator to the Object menu."""
    bpy.utils.register_class(ESD_Preferences)
    bpy.utils.register_class(ESD_OT_transfer)
    bpy.types.VIEW3D_MT_object.append(_menu)


def unregister() -> None:
    """Take it away again."""
    bpy.types.VIEW3D_MT_object.remove(_menu)
    bpy.utils.unregister_class(ESD_OT_transfer)
    bpy.utils.unregister_class(ESD_Preferences)
