import json

import numpy as np

from command import run
from esd.matching.correspondence import load_map
from esd.mesh.io.meshes import read_mesh, write_mesh
from esd.mesh.mesh import Mesh


def test_the_doctor_tells_and_repairs(blob, tmp_path):
    broken, fixed = tmp_path / "broken.ply", tmp_path / "fixed.ply"
    faces = blob.faces[(blob.faces != 9).all(axis=1)][:, ::-1]
    write_mesh(Mesh(np.concatenate([blob.vertices, [[5, 5, 5]]]), faces), broken)
    printed = run("doctor", broken).stdout
    assert "2 vertices without a face" in printed
    assert "1 piece turned inside out" in printed
    assert "Remedy, with --repair: filled where the rim" in printed
    found = json.loads(run("doctor", broken, "--repair", fixed, "--json").stdout)
    assert {f["kind"] for f in found["findings"]} >= {"unreferenced_vertices", "holes"}
    assert found["severity"] == "slight"
    assert found["repaired"]["carried_over"] == len(blob.vertices) - 1
    mesh = read_mesh(fixed)
    index = load_map(
        found["repaired"]["map"],
        source_count=len(blob.vertices) + 1,
        target_count=len(mesh.vertices),
    ).target_index
    np.testing.assert_array_equal(np.flatnonzero(index < 0), [9, len(blob.vertices)])
    # PLY files may hold single precision
    np.testing.assert_allclose(mesh.vertices[index[:9]], blob.vertices[:9], atol=1e-6)
    assert "nothing wrong" in run("doctor", fixed).stdout


def test_commands_take_broken_meshes_and_points_and_say_so(blob, tmp_path):
    points = tmp_path / "points.xyz"
    np.savetxt(points, blob.vertices)
    whole = tmp_path / "whole.off"
    write_mesh(blob, whole)
    torn = tmp_path / "torn.ply"
    write_mesh(
        Mesh(blob.vertices[blob.faces].reshape(-1, 3), np.arange(blob.faces.size).reshape(-1, 3)),
        torn,
    )
    assert "no faces: a point cloud" in run("doctor", points).stdout
    assert (
        "cannot be written as a mesh"
        in run("doctor", points, "--repair", tmp_path / "p.ply", expect=1).stderr
    )
    run("match", points, whole, "-m", "hks", "-o", tmp_path / "m.csv")
    done = run("match", torn, whole, "-m", "hks", "-o", tmp_path / "n.csv", "--json", "--repair")
    summary = json.loads(done.stdout)
    assert summary["matched"] == blob.faces.size
    assert "doubled along seams" in summary["source_findings"]
    assert summary["target_findings"] == ""
    assert done.stderr.count("\n") == 1
    for command in (("descriptor", torn, "-o", tmp_path / "d.npy"), ("spectrum", torn, "-k", 20)):
        extra = () if command[0] == "descriptor" else ("-o", tmp_path / "s.npz")
        assert "doubled along seams" in run(*command, *extra).stderr
    assert np.load(tmp_path / "d.npy").shape == (blob.faces.size, 100)


def test_the_map_beside_an_stl_file_fits_what_a_reader_gets(tmp_path):
    from esd.cli.doctor import _save_index_map
    from esd.mesh.repair.repair import repair
    from esd.mesh.shapes import torus

    mesh = torus(7, 5)
    mesh = Mesh(mesh.vertices[::-1], 34 - mesh.faces[:, ::-1])
    done = repair((mesh.vertices, mesh.faces), everything=True).compacted()
    write_mesh(done.shape, tmp_path / "m.stl")
    _save_index_map(done, done.shape, tmp_path / "map.csv", tmp_path / "m.stl")
    index = load_map(tmp_path / "map.csv", source_count=35, target_count=35).target_index
    back = read_mesh(tmp_path / "m.stl").vertices
    np.testing.assert_allclose(back[index], mesh.vertices, atol=1e-6)  # 32 bits
