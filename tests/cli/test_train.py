import json
from dataclasses import replace

import numpy as np
import pytest

from esd.cli.train import _default_that_fits
from esd.datasets.deformation import deformed
from esd.learning.model import load_model
from esd.learning.presets import preset
from esd.mesh.io.meshes import write_mesh
from esd.mesh.mesh import Mesh
from esd.mesh.shapes import icosphere


@pytest.fixture
def unregistered(tmp_path):
    """A folder of three ellipsoids with three feet, each with its vertices in another order."""
    folder = tmp_path / "unregistered"
    folder.mkdir()
    ball = icosphere(3)
    feet = np.array([[0.8, 0.6, 0], [0, 0.6, 0.8], [-0.6, 0, -0.8]])
    length = np.exp(12 * (ball.vertices @ feet.T - 1)) @ np.array([2.0, 1.2, 0.7])
    mesh = Mesh(ball.vertices * [1.0, 1.2, 1.5] * (1 + length[:, None]), ball.faces)
    for i in range(3):
        copy = deformed(mesh, seed=i, strain=0.1)
        order = np.random.default_rng(i).permutation(len(copy.vertices))
        moved = Mesh(copy.vertices[order], np.argsort(order)[copy.faces])
        write_mesh(moved, folder / f"s{i}.ply")
    return folder


def test_a_folder_of_unregistered_meshes_needs_no_option(run, unregistered, tmp_path):
    (unregistered / "flat.ply").write_bytes((unregistered / "s0.ply").read_bytes()[:2000])
    done = run("train", unregistered, "-o", tmp_path / "model", "--steps", 3)
    assert "trained 3 steps" in done.stdout
    assert "of 3 maps between training shapes: " in done.stdout
    assert "left out: flat: " in done.stdout
    card = json.loads((tmp_path / "model" / "config.json").read_text())["card"]
    assert sum(card["verdicts"].values()) == 3
    assert card["shapes"] == ["s0", "s1", "s2"]
    assert card["curve"][-1]["step"] == 3


def test_what_learning_without_correspondences_cannot_do_is_refused(
    run, unregistered, shapes, tmp_path
):
    where = ("-o", tmp_path / "model")
    done = run("train", unregistered, *where, "--preset", "paper-hks", expect=1)
    assert "has no correspondences, which the preset 'paper-hks' needs" in done.stderr
    done = run("train", unregistered, *where, "--preset", "partial", expect=1)
    assert "has no correspondences, which the preset 'partial' needs" in done.stderr
    done = run("train", unregistered, *where, "--device", "auto", expect=2)
    assert "runs on the CPU only" in done.stderr
    done = run("train", shapes, *where, "--preset", "paper-hks", "--start", "default", expect=2)
    assert "--start is for shapes without" in done.stderr
    assert not (tmp_path / "model").exists()


def test_the_card_says_that_a_surface_training_started_from_the_default_model(
    run, shapes, tmp_path
):
    two = ("--include", "tr_reg_00*,tr_reg_01*")
    run("train", shapes, *two, "--preset", "surface", "--steps", "1", "-o", tmp_path / "m")
    card = json.loads((tmp_path / "m" / "config.json").read_text())["card"]
    assert card["start"] == load_model("default").name


def test_a_surface_training_starts_from_the_default_model_unless_it_does_not_fit():
    surface = preset("surface")
    start = _default_that_fits(surface)
    assert start is not None
    assert start.name == load_model("default").name
    assert _default_that_fits(preset("partial")) is None
    assert _default_that_fits(replace(surface, outputs=16)) is None
    assert _default_that_fits(replace(surface, standardise=False)) is None
