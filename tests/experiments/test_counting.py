from dataclasses import replace

import numpy as np

from esd.evaluation.errors import truth_of
from esd.experiments import counting
from esd.learning.model import raw_model
from esd.mesh.mesh import Mesh


def test_a_shape_matches_its_copy_everywhere_and_a_wrong_truth_nowhere(made):
    source = made.testing.shapes[0]
    moved = replace(
        source, name="moved", mesh=lambda: Mesh(source.mesh().vertices + 1, source.mesh().faces)
    )
    far = replace(moved, name="far", correspondence=lambda: np.roll(np.arange(384), 192))
    models = {"HKS": raw_model("hks"), "strict": replace(raw_model("hks"), margin=1e-300)}
    pairs = [(source, moved), (source, far)]
    raw, strict = counting.correct_matches(made, models, pairs, data="copies")
    assert raw.counts[0] == 384
    assert raw.shares[0] == raw.covered[0] == 1
    assert raw.counts[1] < 20
    assert (raw.covered <= 1).all()
    assert strict.counts[0] < 384  # rounding alone is beyond such a threshold


def test_true_signs_undo_arbitrary_ones(made):
    shape = made.testing.shapes[0]
    values = raw_model("gps").embed_mesh(shape.mesh())
    signs = np.where(np.arange(25) % 2, 1, -1)
    truth = truth_of(shape)
    ends = [counting.Embedded(truth, {"GPS": v, "signed": v}) for v in (values, values * signs)]
    models = {"GPS": raw_model("gps"), "signed": raw_model("gps")}
    found = counting._correct_on_target(ends[1], [ends[0]], models, ["signed"])
    assert found["signed", 0].all()
    assert found["GPS", 0].mean() < 0.5
