"""`esd register`."""

import json

import numpy as np
import pytest

from esd.cli.register import register
from esd.matching.correspondence import Correspondence
from esd.mesh.io.meshes import read_mesh, write_mesh
from esd.mesh.io.ply import ply_bytes, ply_elements
from esd.mesh.mesh import Mesh


def test_a_template_is_registered_with_a_map(run, blob, tmp_path):
    scan = Mesh(blob.vertices[:, [1, 2, 0]] * 2, blob.faces)
    files = [tmp_path / name for name in ("template.ply", "scan.ply", "map.npy", "out.ply")]
    labels = np.arange(len(blob.faces), dtype="<i4")
    files[0].write_bytes(ply_bytes(blob, {"side": blob.vertices[:, 0]}, {"label": labels}))
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
    elements = ply_elements(files[3])
    np.testing.assert_array_equal(elements["vertex"]["side"], blob.vertices[:, 0])
    np.testing.assert_array_equal(elements["face"]["label"], labels)
    before = files[3].read_bytes()
    again = run("register", *files[:2], "--map", files[2], "-o", files[3], expect=1)
    assert "--force" in again.stderr
    assert files[3].read_bytes() == before


def test_landmarks_lead_the_map(blob, tmp_path, monkeypatch):
    files = [tmp_path / name for name in ("template.off", "scan.off", "out.off", "pairs.csv")]
    write_mesh(blob, files[0])
    write_mesh(blob, files[1])
    files[3].write_text("source,target\n5,6\n70,71\n900,901\n")
    given = []

    def true(source, target, *, landmarks, **options):
        given.append(landmarks.tolist())
        count = len(blob.vertices)
        return Correspondence(np.arange(count), np.zeros(count), np.ones(count))

    monkeypatch.setattr("esd.registration.register.match", true)
    register(files[0], [files[1]], files[2], landmarks=files[3:])
    assert given == [[[5, 6], [70, 71], [900, 901]]]
    assert np.array_equal(read_mesh(files[2]).faces, blob.faces)


def test_outputs_never_replace_inputs_and_options_exclude_each_other(run, blob, tmp_path):
    file = tmp_path / "a.ply"
    write_mesh(blob, file)
    before = file.read_bytes()
    run("register", file, file, "-o", file, "--force", expect=1)
    assert file.read_bytes() == before
    both = ("--map", file, "--landmarks", file)
    done = run("register", file, file, "-o", tmp_path / "o.ply", *both, expect=2)
    assert "not both" in done.stderr


def test_the_frames_of_an_animation_are_written_to_a_folder(run, blob, tmp_path):
    for number in (1, 2, 10):
        moved = Mesh(blob.vertices + np.array([0.01 * number, 0, 0]), blob.faces)
        write_mesh(moved, tmp_path / "in" / f"f{number}.off")
    write_mesh(blob, tmp_path / "template.off")
    np.save(tmp_path / "map.npy", np.arange(len(blob.vertices)))
    given = ("--map", tmp_path / "map.npy", "-o", tmp_path / "out")
    done = run("register", tmp_path / "template.off", tmp_path / "in", *given, "--json")
    frames = json.loads(done.stdout)["frames"]
    assert [each["frame"] for each in frames] == ["f1.off", "f2.off", "f10.off"]
    assert [each["by_map"] for each in frames] == [True, False, False]
    found = read_mesh(tmp_path / "out" / "f10.off")
    assert np.linalg.norm(found.vertices - blob.vertices - [0.1, 0, 0], axis=1).mean() < 0.02


@pytest.mark.parametrize(
    ("scans", "code", "message"),
    [
        (["in", "in"], 2, "one folder of frames, or their files"),
        (["empty"], 1, "There is no mesh in 'empty'"),
        (["in/a.off", "other/a.off"], 1, "Several frames are named 'a'"),
        (["in/a.off", "in/none.off"], 1, "in/none.off"),
    ],
)
def test_frames_that_are_missing_or_ambiguous_are_refused(
    run, blob, tmp_path, monkeypatch, scans, code, message
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "empty").mkdir()
    for name in ("template.off", "in/a.off", "other/a.off"):
        write_mesh(blob, tmp_path / name)
    np.save("map.npy", np.arange(len(blob.vertices)))
    done = run("register", "template.off", *scans, "--map", "map.npy", "-o", "out", expect=code)
    assert message in " ".join(done.stderr.split())
