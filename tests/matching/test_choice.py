import pytest

from esd.common import InputError
from esd.matching.candidates import CANDIDATES
from esd.matching.choice import check_candidates, chosen
from esd.matching.judge import accuracy
from esd.matching.match import match


def test_the_choice_is_the_candidate_of_least_cost(pair):
    choice = chosen(*pair)
    assert set(choice.costs) <= set(CANDIDATES)
    assert choice.costs[choice.candidate.name] == min(choice.costs.values())
    assert accuracy(choice.evidence) > 0.9
    [only] = chosen(*pair, names=["extrinsic"]).costs
    assert only == "extrinsic"


def test_unknown_candidates_are_refused(blob):
    with pytest.raises(InputError, match=r"Candidates are embedding, .*; got nearest"):
        check_candidates(["nearest"])
    with pytest.raises(InputError, match="got none"):
        match(blob, blob, candidates=[])


def test_match_names_the_candidate(pair):
    found = match(pair[0].shape, pair[1].shape, candidates=["extrinsic", "descriptors"])
    assert set(found.judgement.costs) == {"extrinsic", "descriptors"}
    assert found.judgement.candidate == min(found.judgement.costs, key=found.judgement.costs.get)
