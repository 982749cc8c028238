import numpy as np
import pytest

from esd.mesh.io.meshes import read_mesh


def test_transfer_of_what_people_have(run_here, pair):
    common = ("a.off", "b.off", "map.csv")
    target = read_mesh(pair / "b.off")
    (pair / "labels.txt").write_text("one\n" * 96)
    run_here("transfer", *common, "--labels", "labels.txt", where=pair)
    assert (pair / "b-labels.txt").read_text() == "one\n" * len(target.vertices)
    np.save(pair / "faces.npy", np.arange(192))
    run_here("transfer", *common, "--labels", "faces.npy", "-o", "f.npy", where=pair)
    assert np.load(pair / "f.npy").shape == (len(target.faces),)
    np.savetxt(pair / "values.txt", target.vertices[:96, 0])
    run_here("transfer", *common, "--values", "values.txt", "--method", "nearest", where=pair)
    assert set(np.loadtxt(pair / "b-values.txt").round(6)) <= set(target.vertices[:96, 0].round(6))
    (pair / "points.csv").write_text("name,vertex\nnose,5\n")
    run_here("transfer", *common, "--landmarks", "points.csv", where=pair)
    assert (pair / "b-landmarks.csv").read_text().splitlines()[1].startswith("nose,5,")
    run_here("transfer", *common, "--morph", 3, where=pair)
    last = read_mesh(pair / "b-morph" / "2.ply")
    assert len(last.vertices) == 96
    done = run_here("transfer", *common, where=pair, expect=2)
    assert "Give one of --texture" in done.stderr
    done = run_here("transfer", *common, "--texture", where=pair, expect=1)
    assert "textures are read from .obj, .glb" in done.stderr


def test_colours_and_texture_are_carried(run_here, pair):
    pytest.importorskip("PIL", reason="pillow is not installed")
    from PIL import Image

    from esd.mesh.io.attributes import read_vertex_colours, write_coloured
    from esd.mesh.io.textures import Texture, read_texture, write_textured

    mesh = read_mesh(pair / "a.off")
    write_coloured(mesh, np.full((96, 4), 200, dtype=np.uint8), pair / "a.ply")
    run_here("transfer", "a.ply", "b.off", "map.csv", "--vertex-colors", where=pair)
    assert set(read_vertex_colours(pair / "b-colours.ply").ravel()) == {200}
    coordinates = np.full((192, 3, 2), 0.5)
    write_textured(mesh, Texture(coordinates, Image.new("RGB", (4, 4), "red")), pair / "t.obj")
    run_here("transfer", "t.obj", "b.off", "map.csv", "--texture", where=pair)
    carried = read_texture(pair / "b-texture.obj")
    np.testing.assert_allclose(carried.coordinates, 0.5)
    assert carried.image.getpixel((0, 0)) == (255, 0, 0)
