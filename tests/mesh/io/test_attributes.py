import base64
import struct
import xml.etree.ElementTree as ElementTree
import zlib

import numpy as np
import pytest
import trimesh

from esd.common import InputError
from esd.mesh.convert import as_mesh, with_attributes
from esd.mesh.io.attributes import (
    read_vertex_colours,
    write_coloured,
    write_mesh_like,
    write_with_attributes,
)
from esd.mesh.io.meshes import read_mesh, write_mesh
from esd.mesh.io.ply import ply_bytes, ply_elements
from esd.mesh.io.textures import Texture, read_texture, write_textured
from esd.mesh.mesh import Mesh
from esd.mesh.shapes import grid, torus

Image = pytest.importorskip("PIL.Image", reason="pillow is not installed")


@pytest.fixture
def attributes():
    generator = np.random.default_rng(0)
    return {"target": np.arange(35) - 1, "error": generator.random(35)}


def test_ply_keeps_attributes_and_order(tmp_path, attributes):
    mesh = torus(7, 5)
    write_with_attributes(mesh, attributes, tmp_path / "m.ply")
    loaded = trimesh.load_mesh(tmp_path / "m.ply", process=False)
    np.testing.assert_array_equal(loaded.faces, mesh.faces)
    np.testing.assert_array_equal(read_mesh(tmp_path / "m.ply").vertices, mesh.vertices)
    raw = loaded.metadata["_ply_raw"]["vertex"]["data"]
    np.testing.assert_array_equal(raw["target"], attributes["target"])
    np.testing.assert_array_equal(raw["error"], attributes["error"].astype("f4"))
    np.testing.assert_array_equal(raw["quality"], attributes["target"].astype("f4"))  # MeshLab
    colours = read_vertex_colours(tmp_path / "m.ply")
    np.testing.assert_array_equal(colours[[0, -1]], [[68, 1, 84, 255], [253, 231, 37, 255]])


def test_vtp_holds_what_its_arrays_say(tmp_path, attributes):
    mesh = torus(7, 5)
    write_with_attributes(mesh, attributes, tmp_path / "m.vtp")
    kinds = {"Float64": "<f8", "Int64": "<i8"}
    arrays = {}
    for node in ElementTree.parse(tmp_path / "m.vtp").iter("DataArray"):
        content = base64.b64decode(node.text)
        assert int.from_bytes(content[:8], "little") == len(content) - 8
        arrays[node.get("Name")] = np.frombuffer(content[8:], kinds[node.get("type")])
    np.testing.assert_array_equal(arrays["Points"].reshape(-1, 3), mesh.vertices)
    np.testing.assert_array_equal(arrays["connectivity"].reshape(-1, 3), mesh.faces)
    np.testing.assert_array_equal(arrays["offsets"], 3 * np.arange(1, 71))
    np.testing.assert_array_equal(arrays["target"], attributes["target"])
    np.testing.assert_array_equal(arrays["error"], attributes["error"])


def test_vtk_reads_vtp(tmp_path, attributes):
    pyvista = pytest.importorskip("pyvista", reason="pyvista is not installed")
    write_with_attributes(torus(7, 5), attributes, tmp_path / "m.vtp")
    loaded = pyvista.read(tmp_path / "m.vtp")
    np.testing.assert_array_equal(loaded.point_data["target"], attributes["target"])
    assert as_mesh(loaded).faces.shape == (70, 3)


def test_attributes_that_do_not_fit_are_refused(tmp_path):
    mesh = torus(7, 5)
    with pytest.raises(InputError, match=r"suffix among .ply, .vtp"):
        write_with_attributes(mesh, {}, tmp_path / "m.obj")
    with pytest.raises(InputError, match=r"'x' must have shape \(35,\); got \(3,\)"):
        write_with_attributes(mesh, {"x": np.ones(3)}, tmp_path / "m.ply")


@pytest.mark.parametrize("suffix", ["ply", "glb"])
def test_colours_come_back(tmp_path, suffix):
    colours = np.random.default_rng(0).integers(0, 256, (35, 4), dtype=np.uint8)
    write_coloured(torus(7, 5), colours, tmp_path / f"m.{suffix}")
    np.testing.assert_array_equal(read_vertex_colours(tmp_path / f"m.{suffix}"), colours)


def test_colours_that_are_not_there_are_missed(tmp_path):
    write_mesh(torus(7, 5), tmp_path / "m.ply")
    with pytest.raises(InputError, match="no colours of its vertices"):
        read_vertex_colours(tmp_path / "m.ply")


@pytest.mark.parametrize("scale", [1, 255])
def test_colours_after_the_coordinates_of_obj_are_read(tmp_path, scale):
    rows = [(0, 0, 0, 1, 0, 0), (1, 0, 0, 0, 0.2, 0), (0, 1, 0, 0, 0, 0.4)]
    lines = [f"v {x} {y} {z} {scale * r} {scale * g} {scale * b}" for x, y, z, r, g, b in rows]
    (tmp_path / "m.obj").write_text("\n".join([*lines, "f 1 2 3", ""]))
    expected = [[255, 0, 0, 255], [0, 51, 0, 255], [0, 0, 102, 255]]
    np.testing.assert_array_equal(read_vertex_colours(tmp_path / "m.obj"), expected)
    for spoilt in ("v 1 0 0", "v 1 0 0 a b c"):
        (tmp_path / "m.obj").write_text("\n".join([lines[0], spoilt, lines[2], "f 1 2 3", ""]))
        with pytest.raises(InputError, match="no colours of its vertices"):
            read_vertex_colours(tmp_path / "m.obj")
    with pytest.raises(InputError, match=r"written to .ply or .glb"):
        write_coloured(torus(7, 5), np.zeros((35, 4), dtype=np.uint8), tmp_path / "m.off")


@pytest.fixture
def texture() -> Texture:
    """On a grid, the image's place is the place on the grid."""
    mesh = grid(5, 4)
    pixels = np.random.default_rng(0).integers(0, 256, (8, 8, 3), dtype=np.uint8)
    return Texture(mesh.vertices[mesh.faces][:, :, :2], Image.fromarray(pixels))


def image_bomb() -> bytes:
    """A PNG file of 57 bytes that announces 3.6 billion pixels."""
    head = struct.pack(">4sIIBBBBB", b"IHDR", 60_000, 60_000, 8, 2, 0, 0, 0)
    chunks = (head, b"IDAT")
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(chunk) - 4) + chunk + struct.pack(">I", zlib.crc32(chunk))
        for chunk in chunks
    )


@pytest.mark.parametrize("suffix", ["obj", "glb"])
def test_textures_come_back(tmp_path, texture, suffix):
    mesh = grid(5, 4)
    write_textured(mesh, texture, tmp_path / f"m.{suffix}")
    back = read_texture(tmp_path / f"m.{suffix}")
    # glTF holds 32 bits
    np.testing.assert_allclose(back.coordinates, texture.coordinates, atol=1e-7)
    np.testing.assert_array_equal(np.asarray(back.image.convert("RGB")), np.asarray(texture.image))
    if suffix == "obj":
        np.testing.assert_array_equal(read_mesh(tmp_path / "m.obj").faces, mesh.faces)


def test_textures_that_are_not_whole_are_refused(tmp_path, texture):
    mesh = grid(5, 4)
    path = tmp_path / "m.obj"
    with pytest.raises(InputError, match=r"written to .obj, .glb"):
        write_textured(mesh, texture, tmp_path / "m.ply")
    with pytest.raises(InputError, match=r"read from .obj, .glb"):
        read_texture(tmp_path / "m.ply")
    write_mesh(mesh, tmp_path / "m.glb")
    with pytest.raises(InputError, match="has no texture"):
        read_texture(tmp_path / "m.glb")
    write_textured(mesh, texture, path)
    whole = path.read_text()
    for content in (b"", image_bomb()):
        (tmp_path / "m.png").write_bytes(content)
        with pytest.raises(InputError, match=r"m.png' cannot be read as an image"):
            read_texture(path)
    (tmp_path / "m.png").unlink()
    with pytest.raises(InputError, match=r"has no image: .*m.png' is missing"):
        read_texture(path)
    path.write_text(whole.replace("mtllib", "# mtllib"))
    with pytest.raises(InputError, match="its material names none"):
        read_texture(path)
    path.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    with pytest.raises(InputError, match="no texture coordinates"):
        read_texture(path)


def test_other_packages_get_their_meshes_back():
    mesh = torus(7, 5)
    values = {"target": np.arange(35)}
    theirs = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    given = with_attributes(theirs, values)
    np.testing.assert_array_equal(given.vertex_attributes["target"], np.arange(35))
    assert "target" not in theirs.vertex_attributes
    meshio = pytest.importorskip("meshio", reason="meshio is not installed")
    given = with_attributes(meshio.Mesh(mesh.vertices, [("triangle", mesh.faces)]), values)
    np.testing.assert_array_equal(given.point_data["target"], np.arange(35))
    with pytest.raises(InputError, match="got Mesh"):
        with_attributes(mesh, values)
    with pytest.raises(InputError, match="each of 35 vertices; got 3"):
        with_attributes(theirs, {"x": np.arange(3)})


@pytest.mark.parametrize("form", ["ascii", "binary_big_endian"])
def test_numbers_at_the_vertices_of_a_ply_file_stay(tmp_path, form):
    mesh = grid(3, 3)
    count = len(mesh.vertices)
    kinds = {"red": ("uchar", ">u1"), "label": ("ushort", ">u2"), "mark": ("int", ">i4")}
    values = {name: np.arange(count) % 7 + 250 for name in kinds}
    values["red"] = np.arange(count) + 200
    head = [f"ply\nformat {form} 1.0\nelement vertex {count}"]
    head += [f"property double {axis}" for axis in ("x", "y", "z", "nx")]
    head += [f"property {kind} {name}" for name, (kind, _) in kinds.items()]
    head += [f"element face {len(mesh.faces)}", "property list uchar int vertex_indices"]
    head = "\n".join([*head, "end_header\n"])
    rows = np.empty(
        count,
        [*((axis, ">f8") for axis in ("x", "y", "z", "nx"))]
        + [(n, k) for n, (_, k) in kinds.items()],
    )
    for axis, column in zip("xyz", mesh.vertices.T, strict=True):
        rows[axis] = column
    rows["nx"] = 0.5
    for name in kinds:
        rows[name] = values[name]
    faces = np.empty(len(mesh.faces), [("count", "u1"), ("corners", ">i4", 3)])
    faces["count"], faces["corners"] = 3, mesh.faces
    if form == "ascii":
        lines = [" ".join(map(str, row.tolist())) for row in rows]
        lines += [f"3 {a} {b} {c}" for a, b, c in mesh.faces]
        content = (head + "\n".join(lines)).encode()
    else:
        content = head.encode() + rows.tobytes() + faces.tobytes()
    (tmp_path / "a.ply").write_bytes(content)
    moved = Mesh(mesh.vertices + 1, mesh.faces)
    write_mesh_like(moved, tmp_path / "b.ply", original=tmp_path / "a.ply")
    np.testing.assert_array_equal(read_mesh(tmp_path / "b.ply").vertices, moved.vertices)
    vertex = ply_elements(tmp_path / "b.ply")["vertex"]
    assert set(vertex) == {"x", "y", "z", *kinds}  # the normals are no longer those
    for name, (_, kind) in kinds.items():
        np.testing.assert_array_equal(vertex[name], values[name])
        assert vertex[name].dtype.str[1:] == kind[1:]


def test_numbers_at_faces_go_along(tmp_path):
    mesh = grid(3, 3)
    labels = np.arange(len(mesh.faces), dtype="<i2")
    (tmp_path / "a.ply").write_bytes(ply_bytes(mesh, {}, {"label": labels, "value": labels / 3}))
    moved = Mesh(mesh.vertices + 1, mesh.faces)
    write_mesh_like(moved, tmp_path / "b.ply", original=tmp_path / "a.ply")
    assert np.array_equal(read_mesh(tmp_path / "b.ply").faces, mesh.faces)
    face = ply_elements(tmp_path / "b.ply")["face"]
    np.testing.assert_array_equal(face["label"], labels)
    np.testing.assert_array_equal(face["value"], labels / 3)
    assert face["label"].dtype.str[1:] == "i2"


def test_groups_and_places_on_an_image_of_an_obj_file_go_along(tmp_path):
    text = """# made by hand
mtllib a.mtl
o square
v 0 0 0 1 0 0
v 1 0 0 0 1 0
v 1 1 0 0 0 1 # last but one
v 0 1 0 1 1 1
vt 0 0
vt 1 1
vn 0 0 1
g left
usemtl skin
f 1/1/1 2/2/1 3/1/1 \\
4/2/1
g right
f 1//1 2//1 3//1
"""
    (tmp_path / "a.obj").write_text(text)
    mesh = read_mesh(tmp_path / "a.obj")
    moved = Mesh(mesh.vertices + 0.5, mesh.faces)
    write_mesh_like(moved, tmp_path / "b.obj", original=tmp_path / "a.obj")
    found = read_mesh(tmp_path / "b.obj")
    np.testing.assert_array_equal(found.vertices, moved.vertices)
    np.testing.assert_array_equal(found.faces, mesh.faces)
    lines = (tmp_path / "b.obj").read_text().splitlines()
    assert lines[:3] == ["# made by hand", "o square", "v 0.5 0.5 0.5 1 0 0"]
    assert lines[6:] == [
        *("vt 0 0", "vt 1 1", "g left", "usemtl skin", "f 1/1 2/2 3/1 4/2", "g right", "f 1 2 3")
    ]


def test_other_formats_take_the_mesh_alone_and_textures_go_along(tmp_path):
    mesh = grid(3, 3)
    moved = Mesh(mesh.vertices + 1, mesh.faces)
    write_mesh(mesh, tmp_path / "plain.obj")
    for name in ("out.off", "out.obj"):
        write_mesh_like(moved, tmp_path / name, original=tmp_path / "plain.obj")
        np.testing.assert_allclose(read_mesh(tmp_path / name).vertices, moved.vertices)
    corners = mesh.vertices[mesh.faces][:, :, :2] / 3
    image = pytest.importorskip("PIL.Image").new("RGBA", (4, 4))
    texture = Texture(corners, image)
    write_textured(mesh, texture, tmp_path / "a.obj")
    write_mesh_like(moved, tmp_path / "b.obj", original=tmp_path / "a.obj")
    np.testing.assert_allclose(read_texture(tmp_path / "b.obj").coordinates, corners, atol=1e-6)


def test_groups_and_materials_of_an_obj_file_with_one_image_go_along(tmp_path):
    image = pytest.importorskip("PIL.Image")
    (tmp_path / "in").mkdir()
    for name, colour in (("skin.png", "red"), ("other.png", "blue")):
        image.new("RGB", (4, 4), colour).save(tmp_path / "in" / name)
    text = """mtllib a.mtl
v 0 0 0
v 1 0 0
v 1 1 0
v 0 1 0
vt 0 0
vt 3 1
g left
usemtl skin
f 1/1 2/2 3/1 4/2
g right
usemtl hair
f 1/1 2/2 3/1
"""
    materials = "newmtl skin\nKs 0 0 1\nmap_Kd skin.png\nmap_Bump b.png\n\nnewmtl hair\nmap_Kd {}\n"
    (tmp_path / "in" / "a.obj").write_text(text)
    (tmp_path / "in" / "a.mtl").write_text(materials.format("skin.png"))
    mesh = read_mesh(tmp_path / "in" / "a.obj")
    moved = Mesh(mesh.vertices + 0.5, mesh.faces)
    write_mesh_like(moved, tmp_path / "b.obj", original=tmp_path / "in" / "a.obj")
    np.testing.assert_array_equal(read_mesh(tmp_path / "b.obj").vertices, moved.vertices)
    lines = (tmp_path / "b.obj").read_text().splitlines()
    assert lines[0] == "mtllib b.mtl"
    assert lines[7:] == text.splitlines()[7:]
    assert (tmp_path / "b.mtl").read_text().split("\n") == [
        *("newmtl skin", "Ks 0 0 1", "map_Kd b.png", "", "newmtl hair", "map_Kd b.png", "")
    ]
    for path in (tmp_path / "in" / "a.obj", tmp_path / "b.obj"):
        texture = read_texture(path)
        assert texture.image.convert("RGB").getpixel((0, 0)) == (255, 0, 0)
        np.testing.assert_array_equal(texture.coordinates[0], [[0, 0], [3, 1], [0, 0]])
    # several images become one, with a material of its own
    (tmp_path / "in" / "a.mtl").write_text(materials.format("other.png"))
    write_mesh_like(moved, tmp_path / "c.obj", original=tmp_path / "in" / "a.obj")
    assert "usemtl texture" in (tmp_path / "c.obj").read_text()
