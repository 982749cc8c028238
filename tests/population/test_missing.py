import numpy as np
import pytest

from esd.mesh.geometry import vertex_areas
from esd.mesh.shapes import icosphere
from esd.population.missing import completed, is_present, missing_parts

SPHERE = icosphere(2)
MASS = vertex_areas(SPHERE) / vertex_areas(SPHERE).sum()


def population() -> np.ndarray:
    """Spheres varied in two ways."""
    x, y, z = SPHERE.vertices.T
    directions = np.stack([SPHERE.vertices * [1.0, 0, 0], np.stack([y * z, x * z, z * z], axis=1)])
    scores = np.random.default_rng(0).normal(size=(12, 2)) * [0.3, 0.1]
    return SPHERE.vertices + np.tensordot(scores, directions, axes=1)


def test_a_vertex_is_there_if_all_of_it_is():
    assert is_present(np.array([[0.0, 1, 2], [0, np.nan, 2]])).tolist() == [True, False]


def test_only_large_pieces_without_support_are_missing():
    supported = SPHERE.vertices[:, 0] < 0.5  # a cap of a quarter of the area
    supported[SPHERE.vertices[:, 0].argmin()] = False  # and one vertex of 162 at the other end
    missing = missing_parts(SPHERE, supported)
    assert (missing == (SPHERE.vertices[:, 0] >= 0.5)).all()
    assert not missing_parts(SPHERE, np.ones(len(supported), dtype=bool)).any()


def test_missing_vertices_are_estimated_from_the_modes():
    shapes = population()
    holes = shapes.copy()
    holes[0, SPHERE.vertices[:, 0] > 0.5] = np.nan
    holes[3, SPHERE.vertices[:, 2] < 0.0] = np.nan
    found = completed(holes, mass=MASS)
    there = ~np.isnan(holes)
    assert (found[there] == shapes[there]).all()
    missed = np.abs(found - shapes).max()
    filled_by_mean = np.abs(np.where(there, shapes, np.nanmean(holes, axis=0)) - shapes).max()
    # the modes that are used explain 90 % of the variance or more
    assert missed < 0.1 * filled_by_mean


def test_shapes_that_are_whole_or_all_alike_stay_as_they_are():
    shapes = population()
    assert completed(shapes, mass=MASS) is shapes
    alike = np.stack([SPHERE.vertices] * 4)
    alike[0, :10] = np.nan
    assert completed(alike, mass=MASS) == pytest.approx(np.stack([SPHERE.vertices] * 4))
