from dataclasses import replace

import pytest
import typer

from esd.cli.options import candidate_names, check_coarse, check_threshold, workers_of
from esd.common import InputError
from esd.learning.model import load_model
from esd.parallel import Workers


def test_names_of_candidates_are_cut_at_commas():
    assert candidate_names(None) is None
    assert candidate_names("embedding, extrinsic") == ("embedding", "extrinsic")
    with pytest.raises(typer.BadParameter, match=r"Candidates are .*; got landmarks"):
        candidate_names("landmarks+extrinsic")
    assert candidate_names("landmarks+extrinsic", landmarks=True) == ("landmarks+extrinsic",)


def test_options_that_exclude_each_other_are_wrong_usage():
    with pytest.raises(typer.BadParameter, match="Give --one-to-one or --coarse, not both"):
        check_coarse(500, one_to_one=True, full=False)
    with pytest.raises(typer.BadParameter, match="Give --full or --coarse, not both"):
        check_coarse(500, one_to_one=False, full=True)
    check_coarse(None, one_to_one=True, full=True)
    with pytest.raises(typer.BadParameter, match="Give --workers or --scheduler, not both"):
        workers_of(2, "tcp://localhost:1")
    assert workers_of(2, None) == Workers(2)


def test_reject_needs_a_margin():
    model = load_model("paper-hks")
    check_threshold(model)
    with pytest.raises(InputError, match="--reject needs a model that was trained with a margin"):
        check_threshold(replace(model, margin=None))
