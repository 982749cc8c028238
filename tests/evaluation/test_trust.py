from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from esd.common import InputError
from esd.datasets.collection import Collection, Shape
from esd.evaluation.trust import verdicts
from esd.learning.model import raw_model
from esd.mesh.mesh import Mesh
from esd.mesh.shapes import icosphere


@pytest.fixture
def collection():
    ball = icosphere(3)
    shapes = [
        Shape(
            name,
            name,
            f"only {name}",
            partial(Mesh, ball.vertices * [1.0, 1.0 + 0.1 * i, 1.6], ball.faces),
            partial(np.arange, 642),
        )
        for i, name in enumerate("abc")
    ]
    return Collection("balls", tuple(shapes))


def test_each_shape_is_matched_with_the_next(collection):
    model, calls = raw_model("hks"), []
    found = verdicts(model, collection, on_pair=lambda: calls.append(1))
    assert sum(found.values()) == len(calls) == 3
    assert set(found) <= {"good", "doubtful", "failed", "mirrored"}
    assert list(found.values()) == sorted(found.values(), reverse=True)
    assert sum(verdicts(model, collection, count=1).values()) == 1


def test_maps_that_cannot_be_computed_have_failed(collection):
    broken = Shape("d", "d", "d", partial(Mesh, np.eye(3), [[0, 1, 2]]), partial(np.arange, 3))
    two = replace(collection, shapes=(collection.shapes[0], broken))
    assert verdicts(raw_model("hks"), two) == {"failed": 2}
    with pytest.raises(InputError, match="two shapes or more; got 1"):
        verdicts(raw_model("hks"), replace(collection, shapes=collection.shapes[:1]))
