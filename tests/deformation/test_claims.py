import numpy as np
import pytest

from esd.deformation.claims import Claims, claims
from esd.deformation.elastic import elastic
from esd.mesh.geodesics import geodesic_distances
from esd.mesh.geometry import surface_area, vertex_normals
from esd.mesh.mesh import Mesh
from esd.mesh.shapes import subdivide, torus

RING = subdivide(torus(32, 12))
UNIT = surface_area(RING) ** 0.5


@pytest.fixture
def ring() -> Mesh:
    return RING


def reflected(mesh: Mesh) -> tuple[np.ndarray, np.ndarray]:
    """Places and normals when the half of negative x lies on the other half."""
    is_folded = mesh.vertices[:, 0] < 0
    sign = np.where(is_folded, -1.0, 1.0)[:, None] * [1.0, 0, 0] + [0.0, 1, 1]
    return mesh.vertices * sign, vertex_normals(mesh) * sign


def test_distances_are_bounded_from_below_by_those_from_anchors(ring):
    found = claims(elastic(ring))
    true = geodesic_distances(ring, np.array([5]), exact=True)[0] / UNIT
    bound = np.abs(found.distance - found.distance[5]).max(axis=1)
    # paths along the edges of a grid are up to √2 times as long as geodesics
    assert (bound <= 1.5 * true + 1e-9).all()
    assert bound[true > 0.5].min() > 0.3


def test_of_two_parts_at_one_place_that_with_more_weight_stays(ring):
    parts = claims(elastic(ring))
    places, normals = reflected(ring)
    is_folded = ring.vertices[:, 0] < 0
    # where they meet, both halves are near each other along the ring
    is_far = np.abs(ring.vertices[:, 0]) > 0.2 * UNIT
    weight = np.where(is_folded, 0.6, 0.9)
    contested = parts.contested(places, normals, weight, unit=UNIT)
    assert contested[is_folded & is_far].all()
    assert not contested[~is_folded].any()
    assert parts.contested(places, normals, 1.5 - weight, unit=UNIT)[~is_folded & is_far].all()


def test_a_surface_that_lies_on_its_place_once_is_not_contested(ring):
    parts = claims(elastic(ring))
    normals = vertex_normals(ring)
    assert not parts.contested(ring.vertices, normals, np.ones(len(normals)), unit=UNIT).any()
    # both sides of what is thin are different places
    flat = ring.vertices * [1.0, 1.0, 1e-3]
    sides = np.where(normals[:, 2:] > 0, [[0.0, 0, 1]], [[0.0, 0, -1]])
    assert not parts.contested(flat, sides, np.ones(len(normals)), unit=UNIT).any()


def test_what_claims_nothing_contests_nothing(ring):
    parts = claims(elastic(ring))
    places, normals = reflected(ring)
    none = np.zeros(len(places))
    assert not parts.contested(places, normals, none, unit=UNIT).any()
    assert not parts.contested(
        places, normals, np.where(ring.vertices[:, 0] < 0, 1.0, 0.0), unit=UNIT
    ).any()
    few = Claims(parts.distance[:3], parts.mass[:3])
    assert not few.contested(places[:3], normals[:3], np.ones(3), unit=UNIT).any()
