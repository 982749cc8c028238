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
    np.testing.assert_array_equal(texture.coordinates, [[[0, 0], [1, 0], [0, 1]]])


def test_images_of_impossible_names_are_missing(tmp_path):
    (tmp_path / "m.obj").write_text(OBJ + "usemtl a\n" + FACE)
    for name in ("x" * 300, "a\0b"):
        (tmp_path / "my look.mtl").write_text(f"newmtl a\nmap_Kd {name}\n")
        with pytest.raises(InputError, match=r"m.obj' has no image: '.*' is missing"):
            read_texture(tmp_path / "m.obj")


def test_several_images_are_refused(tmp_path):
    (tmp_path / "my look.mtl").write_text("newmtl a\nmap_Kd a.png\nnewmtl b\nmap_Kd b.png\n")
    (tmp_path / "m.obj").write_text(OBJ + "usemtl a\n" + FACE + "usemtl b\n" + FACE)
    with pytest.raises(InputError, match=r"several images \('a.png', 'b.png'\)"):
        read_texture(tmp_path / "m.obj")
    (tmp_path / "m.obj").write_text(OBJ + FACE + "usemtl a\n" + FACE)
    with pytest.raises(InputError, match="faces without a material"):
        read_texture(tmp_path / "m.obj")
    (tmp_path / "m.obj").write_text(OBJ + "usemtl c\n" + FACE)
    with pytest.raises(InputError, match="its material names none"):
        read_texture(tmp_path / "m.obj")


def test_without_pillow_the_message_names_the_extra(tmp_path, monkeypatch):
    from esd.mesh.io.textures import Texture

    mesh = Mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    texture = Texture(mesh.vertices[mesh.faces][:, :, :2], Image.new("RGB", (4, 4)))
    write_textured(mesh, texture, tmp_path / "m.glb")
    monkeypatch.setitem(sys.modules, "PIL", None)
    with pytest.raises(InputError, match=r"Pillow: pip install 'embedded-.*\[viz\]'"):
        read_texture(tmp_path / "m.glb")
