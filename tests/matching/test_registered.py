from dataclasses import replace

import numpy as np
import pytest

from esd.learning.model import raw_model
from esd.matching.candidates import Candidate, sampled
from esd.matching.features import shape_features
from esd.matching.registered import REGISTERED, coarse, registered, smoothed, with_embeddings
from esd.mesh.mesh import Mesh
from esd.mesh.repair.repair import repair
from esd.nearest import nearest


def candidate_of(index, count):
    """A candidate whose map is known, and whose map back is the identity."""
    places = np.eye(count, dtype=np.float32)
    return Candidate("embedding", (places[index], places), (places, places), None)


def test_matches_that_are_astray_follow_their_surroundings(bodies):
    count = len(bodies[0].points)
    index = np.arange(count)
    wrong = np.random.default_rng(0).choice(count, count // 8, replace=False)
    index[wrong] = np.roll(wrong, 1)
    found = registered(*map(coarse, bodies), candidate_of(index, count))
    assert found.name == REGISTERED
    for rows in (found.forward, found.backward[::-1]):
        image, _ = nearest(*rows)
        away = np.linalg.norm(bodies[1].points[image] - bodies[1].points, axis=1)
        assert np.mean(away[wrong] > 0.1) < 0.02  # before, all but neighbours were
        assert np.mean(away) < 0.03  # in √area; the vertices are 0.04 apart


def test_a_match_that_does_not_return_counts_little(bodies):
    count = len(bodies[0].points)
    index = np.arange(count)
    patch = np.linalg.norm(bodies[0].points - bodies[0].points[0], axis=1) < 0.2
    index[patch] = np.flatnonzero(patch)[0] + count // 2  # a whole part at a wrong place
    found = registered(*map(coarse, bodies), candidate_of(index, count))
    image, _ = nearest(*found.forward)
    away = np.linalg.norm(bodies[1].points[image] - bodies[1].points, axis=1)
    assert away[patch].mean() < 0.1


def test_a_candidate_that_leads_to_one_place_is_not_registered(bodies):
    index = np.zeros(len(bodies[0].points), dtype=int)
    assert registered(*map(coarse, bodies), candidate_of(index, len(index))) is None


def test_embeddings_are_beside_positions(bodies):
    count = len(bodies[0].points)
    found = registered(*map(coarse, bodies), candidate_of(np.arange(count), count))
    embeddings = tuple(shape.features.embedded for shape in bodies)
    rows = with_embeddings(found, embeddings).embeddings
    for row, position, embedding in zip(rows, found.forward, embeddings, strict=True):
        np.testing.assert_array_equal(row[:, :6], position)
        assert row.shape[1] == 6 + embedding.shape[1]
    spread = [
        np.sqrt(((r - r.mean(axis=0)) ** 2).sum(axis=1).mean())
        for r in np.split(rows[1], [6], axis=1)
    ]
    assert spread[1] == pytest.approx(0.5 * spread[0], rel=1e-5)
    # the embeddings do not depend on their unit
    other = with_embeddings(found, tuple(1000 * each for each in embeddings)).embeddings
    np.testing.assert_allclose(other[0], rows[0], rtol=1e-5, atol=1e-7)


def test_vertices_without_a_face_do_not_count(bodies):
    count = len(bodies[0].points)
    found = registered(*map(coarse, bodies), candidate_of(np.arange(count), count))
    embeddings = tuple(shape.features.embedded.copy() for shape in bodies)
    before = with_embeddings(found, embeddings).embeddings
    embeddings[1][7] = np.nan
    rows = with_embeddings(found, embeddings).embeddings
    assert np.isfinite(rows[0]).all()
    assert np.isfinite(np.delete(rows[1], 7, axis=0)).all()
    np.testing.assert_allclose(rows[0], before[0], rtol=0.05)


def test_a_refined_candidate_keeps_its_map(bodies):
    count = len(bodies[0].points)
    found = registered(*map(coarse, bodies), candidate_of(np.arange(count), count))
    refined = smoothed(*bodies, with_embeddings(found, tuple(b.features.embedded for b in bodies)))
    image, _ = nearest(*refined.forward)
    assert np.linalg.norm(bodies[1].points[image] - bodies[1].points, axis=1).mean() < 0.06


def test_what_is_no_manifold_has_no_copy(blob, monkeypatch):
    monkeypatch.setattr("esd.matching.registered._VERTICES", 200)
    shape = sampled(shape_features(repair(blob), model=raw_model("hks")))
    doubled = Mesh(blob.vertices, np.concatenate([blob.faces, blob.faces[:1]]))
    broken = replace(shape, features=replace(shape.features, shape=doubled))
    assert coarse(shape) is not None
    assert coarse(broken) is None
