from dataclasses import replace

import numpy as np

from esd.matching.candidates import Candidate, extrinsic_candidate, pair_descriptors, sampled
from esd.matching.judge import accuracy, cost, evidence


def test_evidence_is_against_a_map_to_the_wrong_place(pair):
    shapes = tuple(sampled(features) for features in pair)
    descriptors = pair_descriptors(*shapes)
    turn = np.array([[0, 1, 0], [0, 0, 1], [1, 0, 0]])
    right = shapes[0].posed.moved(turn.T.astype(float), np.zeros(3))
    wrong = right.moved(np.diag([-1.0, -1.0, 1.0]), np.zeros(3))
    found = [
        evidence(*shapes, extrinsic_candidate(moved, shapes[1].posed), descriptors)
        for moved in (right, wrong)
    ]
    assert cost(found[0]) < cost(found[1])
    assert accuracy(found[0]) > accuracy(found[1])
    assert found[0].round_trip < found[1].round_trip
    assert found[0].orientation > 0.9


def test_of_a_map_that_does_not_return_nothing_is_expected(pair):
    shapes = tuple(sampled(features) for features in pair)
    generator = np.random.default_rng(0)
    # rows of random numbers: the nearest of those of the other shape are anywhere
    random = Candidate(
        "embedding",
        *(tuple(generator.random((len(s.points), 3)) for s in shapes) for _ in range(2)),
        None,
    )
    found = evidence(*shapes, random, pair_descriptors(*shapes))
    assert found.lost > 0.8
    assert accuracy(found) <= 1 - found.lost


def test_a_reflected_map_turns_the_surface_over(pair):
    shapes = tuple(sampled(features) for features in pair)
    mirror = np.diag([1.0, 1.0, -1.0])
    # nearest points alone: the normals of a reflection point outward as well
    posed = replace(shapes[0].posed, points=shapes[0].posed.points @ mirror)
    candidate = extrinsic_candidate(posed, replace(shapes[0].posed))
    found = evidence(shapes[0], shapes[0], candidate, pair_descriptors(shapes[0], shapes[0]))
    assert found.orientation < 0


def test_surfaces_that_an_affine_motion_brings_onto_each_other_need_no_known_class(pair):
    shapes = tuple(sampled(features) for features in pair)
    turn = np.array([[0, 1, 0], [0, 0, 1], [1, 0, 0]])
    moved = shapes[0].posed.moved(turn.T.astype(float), np.zeros(3))
    found = evidence(
        *shapes, extrinsic_candidate(moved, shapes[1].posed), pair_descriptors(*shapes)
    )
    unlike = replace(found, embeddings=0.45, residual=0.005, uncovered=0.0)
    assert accuracy(unlike) >= 0.97
    for worse in ({"residual": 0.03}, {"uncovered": 0.2}, {"embeddings": 1.3}, {"normals": 0.5}):
        assert accuracy(replace(unlike, **worse)) < 0.97
