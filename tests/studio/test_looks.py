import numpy as np
import pytest

from esd.common import InputError
from esd.matching.correspondence import Correspondence
from esd.mesh.io.attributes import read_vertex_colours, write_coloured
from esd.mesh.io.meshes import read_mesh, write_mesh
from esd.mesh.io.textures import Texture, write_textured
from esd.mesh.mesh import Mesh
from esd.mesh.shapes import grid, torus
from esd.studio.looks import look, write_carried_look

Image = pytest.importorskip("PIL.Image", reason="the extra 'viz' is not installed")


@pytest.fixture
def textured(tmp_path):
    """A sheet over the unit square with an image, the quarters of which differ."""
    sheet = grid(9, 9)
    flat = sheet.vertices - sheet.vertices.min(axis=0)
    place = flat[:, :2] / np.ptp(flat[:, :2], axis=0)
    colours = [[[255, 0, 0], [0, 255, 0]], [[0, 0, 255], [255, 255, 0]]]
    pixels = np.kron(np.array(colours, dtype=np.uint8), np.ones((8, 8, 1), dtype=np.uint8))
    texture = Texture(place[sheet.faces], Image.fromarray(pixels))
    write_textured(sheet, texture, tmp_path / "sheet.obj")
    return tmp_path / "sheet.obj", place


def test_a_texture_is_sampled_with_the_image_upright(textured):
    path, place = textured
    kind, colours = look(path)
    assert kind == "texture"
    for corner, colour in (
        ((0, 0), [0, 0, 255]),  # the lower left
        ((1, 0), [255, 255, 0]),
        ((0, 1), [255, 0, 0]),
        ((1, 1), [0, 255, 0]),
    ):
        inside = 0.6 * np.array(corner) + 0.2
        at = np.abs(place - inside).max(axis=1).argmin()
        assert colours[at].tolist() == colour


def test_colours_of_vertices_are_found_and_nothing_where_there_is_nothing(tmp_path):
    mesh = torus(12, 8)
    given = np.random.default_rng(0).integers(0, 256, (len(mesh.vertices), 4), dtype=np.uint8)
    write_coloured(mesh, given, tmp_path / "a.ply")
    write_mesh(mesh, tmp_path / "b.ply")
    write_mesh(mesh, tmp_path / "b.off")
    kind, colours = look(tmp_path / "a.ply")
    assert kind == "colours"
    np.testing.assert_array_equal(colours, given[:, :3])
    for name in ("b.ply", "b.off"):
        kind, colours = look(tmp_path / name)
        assert kind == ""
        assert colours.shape == (0, 3)


def test_colours_and_textures_are_carried(textured, tmp_path):
    path, _ = textured
    sheet = read_mesh(path)
    count = len(sheet.vertices)
    same = Correspondence(np.arange(count), np.zeros(count), np.ones(count))
    target = Mesh(2 * sheet.vertices, sheet.faces)
    write_carried_look(path, target, same, "texture", tmp_path / "t.obj")
    np.testing.assert_array_equal(look(tmp_path / "t.obj")[1], look(path)[1])
    colours = np.concatenate([look(path)[1], np.full((count, 1), 255, np.uint8)], axis=1)
    write_coloured(sheet, colours, tmp_path / "c.ply")
    write_carried_look(tmp_path / "c.ply", target, same, "colours", tmp_path / "d.ply")
    np.testing.assert_array_equal(read_vertex_colours(tmp_path / "d.ply"), colours)
    with pytest.raises(InputError, match="neither a texture nor colours"):
        write_carried_look(path, target, same, "", tmp_path / "e.glb")
