from dataclasses import replace

import numpy as np
import pytest

from esd.learning.model import raw_model
from esd.matching.candidates import (
    extrinsic_candidate,
    pair_descriptors,
    sampled,
    spectral_candidate,
)
from esd.matching.features import shape_features
from esd.mesh.geometry import surface_area
from esd.mesh.mesh import Mesh
from esd.mesh.repair.repair import repair
from esd.nearest import nearest


def test_samples_are_of_a_shape_of_unit_area(bodies):
    shape = bodies[0]
    mesh = Mesh(shape.points, shape.features.shape.faces)
    assert surface_area(mesh) == pytest.approx(1)
    np.testing.assert_allclose(np.linalg.norm(shape.normals, axis=1), 1)
    assert shape.spectrum.mass.sum() == pytest.approx(1)
    assert len(shape.spectrum.eigenvectors) == len(shape.posed.sample)
    faces = {tuple(face) for face in shape.features.shape.faces}
    assert {tuple(shape.corners[triangle]) for triangle in shape.triangles} <= faces


def test_what_fills_a_hole_is_not_drawn(blob):
    holed = Mesh(blob.vertices, blob.faces[~np.isin(blob.faces, [40, 41]).any(axis=1)])
    features = shape_features(repair(holed, restore=True), model=raw_model("hks"))
    assert features.filling > 0
    shape = sampled(features)
    first = len(features.original_index) - features.filling
    assert shape.corners.max() < first
    assert shape.posed.sample.max() < first


def test_descriptors_of_a_pair_are_those_of_both_and_end_at_the_limit(bodies):
    descriptors = pair_descriptors(*bodies)
    rows = descriptors.rows()
    assert rows[0].shape == rows[1].shape == (512, 48)
    # standardised over both, cut off at three deviations: a mean square of at most nine
    assert 0.5 < np.mean([(each**2).sum(axis=1).mean() for each in rows]) < 9.5
    some = descriptors.at(np.array([3, 5]), np.array([7]))
    np.testing.assert_allclose(some[0], rows[0][[3, 5]], atol=1e-5)  # products in 32 bits
    np.testing.assert_allclose(some[1], rows[1][[7]], atol=1e-5)
    np.testing.assert_array_equal(descriptors.reversed().rows()[0], rows[1])
    there, here = pair_descriptors(*bodies[::-1]).rows()
    # the axes have no sign, products no axes; 32 bits
    np.testing.assert_allclose(here @ there.T, rows[0] @ rows[1].T, atol=1e-3)


def test_a_candidate_is_refined_from_its_start(bodies):
    rows = pair_descriptors(*bodies).rows()
    true = np.arange(len(bodies[0].posed.sample))
    same, values = (bodies[1], bodies[1]), (rows[1], rows[1])
    found = spectral_candidate("x", *same, values, start=(true, true), sizes=(8, 14, 20))
    assert found.name == "x"
    for forward in (found.forward, found.backward):
        assert (nearest(*forward)[0] == np.arange(512)).mean() > 0.99


def test_the_extrinsic_candidate_takes_the_nearest_point_on_the_same_side():
    from esd.matching.extrinsic import posed
    from esd.mesh.shapes import icosphere

    ball = icosphere(3)
    # two walls of a thin shell: the inner one is as near, with normals the other way
    shell = Mesh(
        np.concatenate([ball.vertices, 0.98 * ball.vertices]),
        np.concatenate([ball.faces, 642 + ball.faces[:, ::-1]]),
    )
    pose = posed(shell, filling=np.zeros(1284, dtype=bool), seed=0)
    moved = replace(pose, points=pose.points * 0.99)  # the outer wall between the two
    index, _ = nearest(*extrinsic_candidate(moved, pose).forward)
    assert (index[:642] < 642).mean() > 0.99
