from dataclasses import replace

import numpy as np
import pytest

from esd.common import InputError
from esd.learning.model import load_model
from esd.matching.candidates import CANDIDATES, extrinsic_candidate, pair_descriptors, sampled
from esd.matching.choice import check_candidates, chosen
from esd.matching.features import shape_features
from esd.matching.judge import accuracy, cost, evidence
from esd.matching.match import match
from esd.mesh.mesh import Mesh
from esd.mesh.repair.repair import repair

MODEL = load_model("default")


@pytest.fixture
def pair(blob):
    """Two shapes of one pose, vertex i of one being vertex i of the other."""
    bend = 0.05 * np.sin(blob.vertices[:, [1, 2, 0]] * 2 + np.arange(3))
    other = Mesh((blob.vertices + bend) @ [[0, 1, 0], [0, 0, 1], [1, 0, 0]], blob.faces)
    return tuple(shape_features(repair(mesh), model=MODEL) for mesh in (blob, other))


def test_the_choice_is_the_candidate_of_least_cost(pair):
    choice = chosen(*pair)
    assert set(choice.costs) <= set(CANDIDATES)
    assert choice.costs[choice.candidate.name] == min(choice.costs.values())
    assert accuracy(choice.evidence) > 0.9
    [only] = chosen(*pair, names=["extrinsic"]).costs
    assert only == "extrinsic"


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


def test_a_reflected_map_turns_the_surface_over(pair):
    shapes = tuple(sampled(features) for features in pair)
    mirror = np.diag([1.0, 1.0, -1.0])
    # nearest points alone: the normals of a reflection point outward as well
    posed = replace(shapes[0].posed, points=shapes[0].posed.points @ mirror)
    candidate = extrinsic_candidate(posed, replace(shapes[0].posed))
    found = evidence(shapes[0], shapes[0], candidate, pair_descriptors(shapes[0], shapes[0]))
    assert found.orientation < 0


def test_unknown_candidates_are_refused(blob):
    with pytest.raises(InputError, match=r"Candidates are embedding, .*; got nearest"):
        check_candidates(["nearest"])
    with pytest.raises(InputError, match="got none"):
        match(blob, blob, candidates=[])


def test_match_names_the_candidate(pair):
    found = match(pair[0].shape, pair[1].shape, candidates=["extrinsic", "descriptors"])
    assert set(found.judgement.costs) == {"extrinsic", "descriptors"}
    assert found.judgement.candidate == min(found.judgement.costs, key=found.judgement.costs.get)
