from dataclasses import replace

import pytest

from esd.common import InputError
from esd.matching import choice
from esd.matching.candidates import CANDIDATES
from esd.matching.choice import check_candidates, chosen, elastic
from esd.matching.judge import accuracy, cost
from esd.matching.match import _full_maps, _tightened, match
from esd.matching.registered import REGISTERED

DOUBTFUL = {"lost": 0.8, "residual": 0.1}


def test_the_choice_is_the_candidate_of_least_cost(pair):
    best = chosen(*pair)
    assert set(best.costs) <= set(CANDIDATES)
    assert best.costs[best.candidate.name] == min(best.costs.values())
    assert accuracy(best.evidence) > 0.9
    [only] = chosen(*pair, names=["extrinsic"]).costs
    assert only == "extrinsic"


def test_unknown_candidates_are_refused(blob):
    with pytest.raises(InputError, match=r"Candidates are embedding, .*; got nearest"):
        check_candidates(["nearest"])
    with pytest.raises(InputError, match="got none"):
        match(blob, blob, candidates=[])


def test_registration_is_for_choices_that_are_not_sure(pair):
    sure = chosen(pair[0], pair[0])
    assert elastic(sure) is sure
    doubtful = chosen(*pair)
    doubtful = replace(doubtful, evidence=replace(doubtful.evidence, **DOUBTFUL))
    found = elastic(doubtful)
    assert found.costs.keys() - doubtful.costs.keys() == {REGISTERED}
    others = found.computed[len(doubtful.computed) :]
    assert {candidate.name for candidate, _ in others} == {REGISTERED}
    assert len(others) == len(doubtful.computed) + 1  # one more, of the best
    assert found.costs[REGISTERED] == min(cost(evidence) for _, evidence in others)


def test_candidates_that_cannot_be_registered_are_left_as_they_are(pair, monkeypatch):
    doubtful = chosen(*pair)
    doubtful = replace(doubtful, evidence=replace(doubtful.evidence, **DOUBTFUL))
    monkeypatch.setattr("esd.matching.choice.registered", lambda *_: None)
    assert elastic(doubtful) is doubtful


def test_shapes_of_one_pose_are_not_registered(pair):
    doubtful = chosen(*pair)
    alike = DOUBTFUL | {"residual": 0.01}
    doubtful = replace(doubtful, evidence=replace(doubtful.evidence, **alike))
    assert elastic(doubtful) is doubtful


def test_a_registered_candidate_is_taken_where_it_costs_little_more(pair):
    doubtful = chosen(*pair)
    doubtful = replace(doubtful, evidence=replace(doubtful.evidence, **DOUBTFUL))
    dear = replace(doubtful, costs=dict.fromkeys(doubtful.costs, 1000.0))
    assert elastic(dear).candidate.name == REGISTERED
    assert elastic(dear).candidate.embeddings is not None
    cheap = replace(doubtful, costs=dict.fromkeys(doubtful.costs, -1000.0))
    assert elastic(cheap).candidate is doubtful.candidate


def test_registration_starts_from_other_candidates():
    with pytest.raises(InputError, match="'registered' starts from others"):
        check_candidates(["registered"])


def test_match_names_the_candidate(pair):
    found = match(pair[0].shape, pair[1].shape, candidates=["extrinsic", "descriptors"])
    assert set(found.judgement.costs) == {"extrinsic", "descriptors"}
    assert found.judgement.candidate == min(found.judgement.costs, key=found.judgement.costs.get)


def test_a_sure_map_between_different_poses_needs_no_alignment(pair, monkeypatch):
    sought = []

    def aligned(*arguments, **keywords):
        sought.append(arguments)
        return original(*arguments, **keywords)

    original = choice.aligned
    monkeypatch.setattr(choice, "aligned", aligned)
    monkeypatch.setattr(choice, "_SURE", 0.5)
    monkeypatch.setattr(choice, "_NOT_AFFINE", 1.0)
    chosen(*pair)
    assert len(sought) == 1
    monkeypatch.setattr(choice, "_NOT_AFFINE", 0.0)
    assert set(chosen(*pair).costs) == {"embedding"}
    assert len(sought) == 1


@pytest.mark.parametrize("best", ["refined", "registered again", "as it came"])
def test_of_a_registered_pair_the_map_of_least_cost_is_taken(pair, monkeypatch, best):
    doubtful = chosen(*pair)
    evidence = replace(doubtful.evidence, **DOUBTFUL)
    dear = dict.fromkeys(doubtful.costs, 1000.0)
    found = elastic(replace(doubtful, evidence=evidence, costs=dear))
    refined = _full_maps(*pair, found.candidate, refine=True, device="cpu")
    order = ["refined", "registered again", "as it came"]  # in which their costs are asked for
    costs = iter([float(name != best) for name in order])
    monkeypatch.setattr("esd.matching.match.cost", lambda _: next(costs))
    raw = _full_maps(*pair, found.candidate, refine=False, device="cpu")
    monkeypatch.setattr("esd.matching.match._full_maps", lambda *_, **__: raw)
    taken = _tightened(*pair, found, refined, device="cpu")
    assert [taken is refined, taken is raw] == [best == "refined", best == "as it came"]


@pytest.mark.parametrize("best", ["refined", "as it came"])
def test_an_aligned_map_is_refined_where_that_costs_less(pair, monkeypatch, best):
    found = chosen(*pair, names=["extrinsic"])
    assert found.candidate.is_extrinsic and found.copies is None
    refined = _full_maps(*pair, found.candidate, refine=True, device="cpu")
    raw = _full_maps(*pair, found.candidate, refine=False, device="cpu")
    costs = iter([float(name != best) for name in ("refined", "as it came")])
    monkeypatch.setattr("esd.matching.match.cost", lambda _: next(costs))
    monkeypatch.setattr("esd.matching.match._full_maps", lambda *_, **__: raw)
    taken = _tightened(*pair, found, refined, device="cpu")
    assert taken is (refined if best == "refined" else raw)
