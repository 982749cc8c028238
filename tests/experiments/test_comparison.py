from dataclasses import replace

import numpy as np
import pytest

from esd.evaluation.errors import truth_of
from esd.experiments import comparison
from esd.mesh.geometry import vertex_areas
from esd.mesh.mesh import Mesh


def test_points_are_sampled_by_area_and_disparity_is_none_without_change(made):
    shape = made.testing.shapes[0]
    larger = replace(shape, mesh=lambda: Mesh(3 * shape.mesh().vertices + 1, shape.mesh().faces))
    assert comparison._disparity(truth_of(shape), truth_of(larger)) == pytest.approx(0, abs=1e-9)
    areas = vertex_areas(shape.mesh())
    draws = [comparison._sampled(shape, shape, None, (0, i)) for i in range(200)]
    assert all(len(np.unique(draw)) == 38 for draw in draws)
    large = areas > np.median(areas)
    # half of the vertices; without replacement a little less than their share of the area
    share = np.mean([large[draw].mean() for draw in draws])
    assert share == pytest.approx(areas[large].sum() / areas.sum(), abs=0.03)
