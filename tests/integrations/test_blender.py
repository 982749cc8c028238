"""The add-on in a headless Blender: the wheel `bpy`, in this Python or in the one of ESD_BPY."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from esd.mesh.io.meshes import write_mesh
from esd.mesh.mesh import Mesh
from esd.mesh.shapes import subdivide, torus

ADDON = Path(__file__).parents[2] / "integrations" / "blender" / "esd_correspondence.py"

IN_BLENDER = """
import importlib.util, json, sys
import bpy
import bmesh, numpy as np  # bmesh is there once bpy is

addon_path, python, folder = sys.argv[1:4]
spec = importlib.util.spec_from_file_location("esd_correspondence", addon_path)
addon = importlib.util.module_from_spec(spec)
sys.modules["esd_correspondence"] = addon
spec.loader.exec_module(addon)
addon.register()

bpy.ops.wm.read_factory_settings(use_empty=True)
things = []
for name in ("source", "target"):
    with np.load(f"{folder}/{name}.npz") as arrays:
        mesh = bpy.data.meshes.new(name)
        mesh.from_pydata(arrays["vertices"].tolist(), [], arrays["faces"].tolist())
    things.append(bpy.data.objects.new(name, mesh))
    bpy.context.collection.objects.link(things[-1])
source, target = things
# quadrilaterals, as artists make them; the order of the vertices stays
whole = bmesh.new()
whole.from_mesh(target.data)
bmesh.ops.join_triangles(
    whole, faces=whole.faces[:], angle_face_threshold=0.7, angle_shape_threshold=0.7
)
whole.to_mesh(target.data)
rig = bpy.data.objects.new("rig", None)
bpy.context.collection.objects.link(rig)
points = np.array([v.co for v in source.data.vertices])
group = source.vertex_groups.new(name="upper")
for i in np.flatnonzero(points[:, 1] > 0).tolist():
    group.add([i], 1.0, "REPLACE")
source.shape_key_add(name="Basis", from_mix=False)
key = source.shape_key_add(name="along x", from_mix=False)
for i, point in enumerate(points):
    key.data[i].co = point + [0.1, 0, 0]
layer = source.data.uv_layers.new(name="UVMap")
for loop in source.data.loops:
    layer.data[loop.index].uv = (points[loop.vertex_index][:2] + 2) / 4

def run(**options):
    for thing in (*things, rig):  # what is no mesh does not matter
        thing.select_set(True)
    bpy.context.view_layer.objects.active = source
    return list(bpy.ops.object.esd_transfer(python=python, **options))

def found():
    weights = [sum(m.weight for m in v.groups) for v in target.data.vertices]
    keys = target.data.shape_keys.key_blocks
    basis = np.array([p.co for p in keys["Basis"].data])
    offset = np.array([p.co for p in keys["along x"].data]) - basis
    uvs = np.zeros((len(basis), 2))
    for loop in target.data.loops:
        uvs[loop.vertex_index] = target.data.uv_layers["UVMap"].data[loop.index].uv
    return {"weights": weights, "offset": offset, "uvs": uvs}

answers = {"first": run(), "second": run()}
answers["quadrilaterals"] = sum(len(face.vertices) == 4 for face in target.data.polygons)
np.savez(f"{folder}/found.npz", **found())
answers["by file"] = run(map_file=f"{folder}/true.txt")
np.savez(f"{folder}/by_file.npz", **found())
try:
    run(weights=False, uvs=False, keys=False)
except RuntimeError as error:
    answers["nothing"] = str(error)
try:
    bpy.ops.object.esd_transfer(python="/no/such/python")
except RuntimeError as error:
    answers["no python"] = str(error)
keys = target.data.shape_keys.key_blocks
answers |= {"groups": len(target.vertex_groups), "keys": len(keys), "layers": len(target.data.uv_layers)}
twin = bpy.data.objects.new("twin", source.data)
bpy.context.collection.objects.link(twin)
target.select_set(False)
things[1] = twin
try:
    run()
except RuntimeError as error:
    answers["shared"] = str(error)
addon.unregister()
print(json.dumps(answers))
"""


@pytest.fixture
def blender() -> str:
    """A Python that has Blender."""
    for python in filter(None, (os.environ.get("ESD_BPY"), sys.executable)):
        if subprocess.run([python, "-c", "import bpy"], capture_output=True).returncode == 0:
            return python
    pytest.skip("bpy is not installed; name a Python that has it in ESD_BPY")


def test_weights_keys_and_uvs_are_transferred(blender, tmp_path):
    mesh = subdivide(torus(32, 16))
    x, y, z = mesh.vertices.T
    bend = 1 + 0.3 * x + 0.25 * y + 0.2 * y * z  # nothing takes it to itself
    source = Mesh(mesh.vertices * bend[:, None], mesh.faces)
    order = np.random.default_rng(0).permutation(len(x))  # vertex i of the target is order[i]
    back = np.argsort(order)
    # a quarter turn about z, and twice as large
    turned = 2 * source.vertices[order] @ np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1.0]]).T
    target = Mesh(turned, back[source.faces])
    for name, shape in (("source", source), ("target", target)):
        np.savez(tmp_path / f"{name}.npz", vertices=shape.vertices, faces=shape.faces)
        write_mesh(shape, tmp_path / f"{name}.off")
    (tmp_path / "true.txt").write_text("".join(f"{i + 1}\n" for i in back))
    script = tmp_path / "script.py"
    script.write_text(IN_BLENDER)
    command = [blender, str(script), str(ADDON), sys.executable, str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    answers = json.loads(done.stdout.strip().splitlines()[-1])
    assert answers["first"] == answers["second"] == ["FINISHED"]
    assert (answers["groups"], answers["keys"], answers["layers"]) == (1, 2, 1)
    assert "nothing of what is to be transferred" in answers["nothing"]
    assert "cannot be run" in answers["no python"]
    assert "share one mesh" in answers["shared"]
    assert answers["by file"] == ["FINISHED"]
    assert answers["quadrilaterals"] > 1000
    upper = source.vertices[order, 1] > 0
    uvs = (source.vertices[order, :2] + 2) / 4
    # 0.1 along x has become 0.2 along y, as the shape was turned and scaled; float32 in Blender
    for name, share, near in (("found", 0.97, 0.03), ("by_file", 1.0, 1e-4)):
        with np.load(tmp_path / f"{name}.npz") as found:
            assert ((found["weights"] > 0.5) == upper).mean() >= share
            assert np.linalg.norm(found["offset"] - [0, 0.2, 0], axis=1).mean() < near
            assert np.linalg.norm(found["uvs"] - uvs, axis=1).mean() < near / 3
