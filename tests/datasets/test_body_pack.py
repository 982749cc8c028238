from dataclasses import replace

import numpy as np
import pytest

from esd.common import InputError
from esd.datasets.bodies import (
    _pack,
)
from esd.datasets.body_pack import posed, read_pack, sampled, skinned, write_pack


def test_reading_agrees_with_the_model_to_a_twentieth_of_a_millimetre():
    pack = _pack()
    subjects, poses, count, _ = pack.samples.shape
    assert (subjects, poses) == (14, 10)
    vertex = sampled(pack.rest.shape[1], count=count)
    for subject in range(subjects):
        for pose in range(poses):
            found = posed(pack, subject=subject, pose=pose)[vertex]
            assert np.abs(found - pack.samples[subject, pose]).max() < 5e-5


def test_skinning_by_one_motion_moves_rigidly():
    random = np.random.default_rng(0)
    points, weights = random.normal(size=(50, 3)), random.dirichlet(np.ones(4), size=50)
    turn, _ = np.linalg.qr(random.normal(size=(3, 3)))
    motion = np.concatenate([turn, [[1.0], [2.0], [3.0]]], axis=1)
    moved = skinned(points, weights, np.tile(motion, (4, 1, 1)))
    assert np.allclose(moved, points @ turn.T + [1, 2, 3])


def test_packs_survive_writing(tmp_path):
    pack = _pack()
    first, second = tmp_path / "first.npz", tmp_path / "second.npz"
    write_pack(pack, first)
    write_pack(pack, second)
    assert first.read_bytes() == second.read_bytes()
    again = read_pack(first)
    # coordinates and motions are on their grids already; weights are rounded to 24 bits
    assert (again.rest == pack.rest).all()
    assert (again.motions == pack.motions).all()
    assert (again.faces == pack.faces).all()
    assert (again.mirror == pack.mirror).all()
    assert (again.parts == pack.parts).all()
    assert np.abs(again.weights - pack.weights).max() < 2e-7


def test_a_pack_that_reaches_too_far_is_refused(tmp_path):
    pack = _pack()
    with pytest.raises(InputError, match=r"within 1.3 m"):
        write_pack(replace(pack, rest=2 * pack.rest), tmp_path / "far.npz")
