"""Judging maps between points without faces; the vertices of bodies whose truth is known."""

from dataclasses import replace

import numpy as np
import pytest

from esd.common import InputError
from esd.learning.model import load_model
from esd.matching.features import shape_features
from esd.matching.match import match
from esd.matching.points import accuracy_of_points, evidence_of_points, with_surface
from esd.mesh.mesh import PointCloud
from esd.mesh.repair.repair import repair


@pytest.fixture(scope="module")
def clouds():
    """The vertices of a shape and of a bent copy, with surfaces between them."""
    from esd.mesh.shapes import subdivide, torus

    mesh = subdivide(torus(24, 12))
    x, y, z = mesh.vertices.T.copy()
    swollen = mesh.vertices * (1 + 0.3 * x + 0.2 * y * z)[:, None]
    here = swollen + 0.1 * mesh.vertices[:, [1, 2, 0]] ** 2
    there = here + 0.05 * np.sin(2 * here[:, [2, 0, 1]])
    model = load_model("hks")
    return [
        with_surface(shape_features(repair(PointCloud(points)), model=model))
        for points in (here, there)
    ]


def test_right_maps_of_points_are_expected_to_be_right_and_wrong_ones_not(clouds):
    count = len(clouds[0].shape.vertices)
    true = np.arange(count)
    right = evidence_of_points(*clouds, true, true)
    assert accuracy_of_points(right) > 0.8
    assert right.orientation > 0.9
    random = np.random.default_rng(0).permutation(count)
    assert accuracy_of_points(evidence_of_points(*clouds, random, random)) < 0.3


def test_maps_of_points_have_a_verdict(blob):
    points = PointCloud(blob.vertices)
    found = match(points, points, model="hks")
    assert found.judgement.verdict == "good"
    assert found.judgement.expected_accuracy > 0.9
    # the Laplacians of points and of faces differ: few are matched rightly, and that is expected
    found = match(points, blob, model="hks")
    away = np.linalg.norm(blob.vertices[found.target_index] - blob.vertices, axis=1)
    right = (away < 0.05 * np.ptp(blob.vertices, axis=0).max()).mean()
    assert abs(found.judgement.expected_accuracy - right) < 0.2
    # a mesh keeps its own faces
    shape = shape_features(repair(blob), model=load_model("hks"))
    assert with_surface(shape) is shape


def test_points_without_a_surface_between_them_have_no_verdict(blob, clouds):
    line = PointCloud(np.arange(30)[:, None] * np.ones(3))
    with pytest.raises(InputError, match="No surface can be seen between the points"):
        with_surface(replace(clouds[0], shape=line))
