"""`esd register`."""

import json

import numpy as np

from command import run
from esd.mesh.io.meshes import read_mesh, write_mesh
from esd.mesh.mesh import Mesh


def test_a_template_is_registered_with_a_map(blob, tmp_path):
    scan = Mesh(blob.vertices[:, [1, 2, 0]] * 2, blob.faces)
    files = [tmp_path / name for name in ("template.ply", "scan.ply", "map.npy", "out.ply")]
    write_mesh(blob, files[0])
    write_mesh(scan, files[1])
    np.save(files[2], np.arange(len(blob.vertices)))
    done = run("register", *files[:2], "--map", files[2], "-o", files[3], "--json")
    summary = json.loads(done.stdout)
    assert summary["inverted"] == 0
    assert summary["relative_distance"] < 0.002
    found = read_mesh(files[3])
    assert np.array_equal(found.faces, blob.faces)
    assert np.linalg.norm(found.vertices - scan.vertices, axis=1).mean() < 0.02 * np.ptp(
        scan.vertices
    )
    before = files[3].read_bytes()
    again = run("register", *files[:2], "--map", files[2], "-o", files[3], expect=1)
    assert "--force" in again.stderr
    assert files[3].read_bytes() == before


def test_outputs_never_replace_inputs_and_options_exclude_each_other(blob, tmp_path):
    file = tmp_path / "a.ply"
    write_mesh(blob, file)
    before = file.read_bytes()
    run("register", file, file, "-o", file, "--force", expect=1)
    assert file.read_bytes() == before
    both = ("--map", file, "--landmarks", file)
    done = run("register", file, file, "-o", tmp_path / "o.ply", *both, expect=2)
    assert "not both" in done.stderr
