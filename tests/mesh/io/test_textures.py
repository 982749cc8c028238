import sys

import numpy as np
import pytest

from esd.common import InputError
from esd.mesh.io.textures import read_texture, write_textured
from esd.mesh.mesh import Mesh

Image = pytest.importorskip("PIL.Image", reason="pillow is not installed")

OBJ = "mtllib my look.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\n"
FACE = "f 1/1 2/2 3/3\n"


@pytest.mark.parametrize("named", ["-s 1 1 1 my skin.jpg", "maps\\my skin.jpg"])
def test_names_have_spaces_and_backslashes_and_images_are_converted(tmp_path, named):
    (tmp_path / "maps").mkdir()
    for folder in (tmp_path, tmp_path / "maps"):
        Image.new("CMYK", (4, 4)).save(folder / "my skin.jpg")
    (tmp_path / "my look.mtl").write_text(f"newmtl a b\nmap_Kd {named}\n")
    (tmp_path / "m.obj").write_text(OBJ + "usemtl a b\n" + FACE)
    texture = read_texture(tmp_path / "m.obj")
    assert texture.image.mode == "RGB"
    assert min(texture.image.getpixel((1, 1))) > 250  # CMYK without ink is white
    np.testing.assert_array_equal(texture.coordinates, [[[0, 0], [1, 0], [0, 1]]])


def test_images_of_impossible_names_are_missing(tmp_path):
    (tmp_path / "m.obj").write_text(OBJ + "usemtl a\n" + FACE)
    for name in ("x" * 300, "a\0b"):
        (tmp_path / "my look.mtl").write_text(f"newmtl a\nmap_Kd {name}\n")
        with pytest.raises(InputError, match=r"m.obj' has no image: '.*' is missing"):
            read_texture(tmp_path / "m.obj")


def test_several_images_become_one(tmp_path):
    (tmp_path / "my look.mtl").write_text("newmtl a\nmap_Kd a.png\nnewmtl b\nmap_Kd b.png\n")
    Image.new("RGB", (4, 4), (255, 0, 0)).save(tmp_path / "a.png")
    Image.new("L", (2, 8), 100).save(tmp_path / "b.png")
    (tmp_path / "m.obj").write_text(OBJ + "usemtl b\n" + FACE + "usemtl a\n" + FACE)
    texture = read_texture(tmp_path / "m.obj")
    assert texture.image.size == (8, 8)
    assert texture.image.getpixel((1, 1)) == (255, 0, 0, 255)  # of the second face
    assert texture.image.getpixel((6, 6)) == (100, 100, 100, 255)
    np.testing.assert_array_equal(texture.coordinates[1], [[0, 0], [0.5, 0], [0, 1]])
    np.testing.assert_array_equal(texture.coordinates[0], [[0.5, 0], [1, 0], [0.5, 1]])
    (tmp_path / "m.obj").write_text(
        OBJ.replace("vt 1 0", "vt 3 0") + "usemtl b\n" + FACE + "usemtl a\n" + FACE
    )
    # the images are repeated three times across, of which the first face sees all
    texture = read_texture(tmp_path / "m.obj")
    assert texture.image.size == (3 * 8, 8)
    np.testing.assert_allclose(texture.coordinates[0], [[0.5, 0], [1, 0], [0.5, 1]])
    assert [texture.image.getpixel((x, 4))[0] for x in (1, 9, 13)] == [255, 255, 100]
    (tmp_path / "m.obj").write_text(
        OBJ.replace("vt 1 0", "vt 99 0") + "usemtl b\n" + FACE + "usemtl a\n" + FACE
    )
    with pytest.raises(InputError, match="repeats images 99 × 1 times over one face"):
        read_texture(tmp_path / "m.obj")
    # a face on another repetition looks the same on the first
    (tmp_path / "m.obj").write_text(
        OBJ.replace("vt 0 0", "vt -2 5").replace("vt 1 0", "vt -1 5").replace("vt 0 1", "vt -2 6")
        + "usemtl b\n"
        + FACE
        + "usemtl a\n"
        + FACE
    )
    texture = read_texture(tmp_path / "m.obj")
    assert texture.image.size == (8, 8)
    np.testing.assert_array_equal(texture.coordinates[1], [[0, 0], [0.5, 0], [0, 1]])


def test_several_images_of_glb_become_one(tmp_path):
    import trimesh

    mesh = Mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])

    def part(image=None):
        visual = image and trimesh.visual.TextureVisuals(uv=mesh.vertices[:, :2], image=image)
        return trimesh.Trimesh(mesh.vertices, mesh.faces, process=False, visual=visual)

    images = [Image.new("RGB", (4, 4), colour) for colour in ((255, 0, 0), (0, 0, 255))]
    scene = trimesh.Scene([part(image) for image in images])
    scene.export(tmp_path / "m.glb")
    texture = read_texture(tmp_path / "m.glb")
    seen = [
        texture.image.getpixel((int(7 * u), 2))[:3] for u in texture.coordinates.mean(axis=1)[:, 0]
    ]
    assert seen == [(255, 0, 0), (0, 0, 255)]
    trimesh.Scene([part(images[0]), part()]).export(tmp_path / "m.glb")
    with pytest.raises(InputError, match="has an image on some of its faces only"):
        read_texture(tmp_path / "m.glb")


def test_faces_without_an_image_are_refused(tmp_path):
    (tmp_path / "my look.mtl").write_text("newmtl a\nmap_Kd a.png\nnewmtl b\nKd 1 1 1\n")
    (tmp_path / "m.obj").write_text(OBJ + "usemtl a\n" + FACE + "usemtl b\n" + FACE)
    with pytest.raises(InputError, match="no image at some faces: their material names none"):
        read_texture(tmp_path / "m.obj")
    (tmp_path / "m.obj").write_text(OBJ + FACE + "usemtl a\n" + FACE)
    with pytest.raises(InputError, match="faces without a material"):
        read_texture(tmp_path / "m.obj")
    (tmp_path / "m.obj").write_text(OBJ + "usemtl c\n" + FACE)
    with pytest.raises(InputError, match="their material names none"):
        read_texture(tmp_path / "m.obj")


def test_without_pillow_the_message_names_the_extra(tmp_path, monkeypatch):
    from esd.mesh.io.textures import Texture

    mesh = Mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    texture = Texture(mesh.vertices[mesh.faces][:, :, :2], Image.new("RGB", (4, 4)))
    write_textured(mesh, texture, tmp_path / "m.glb")
    monkeypatch.setitem(sys.modules, "PIL", None)
    with pytest.raises(InputError, match=r"Pillow: pip install 'embedded-.*\[viz\]'"):
        read_texture(tmp_path / "m.glb")
