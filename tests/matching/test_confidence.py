from dataclasses import replace

import numpy as np
import pytest

from esd.matching.confidence import Overlap, confidence, evidence, judgement, orientation
from esd.matching.match import with_similarity
from esd.mesh.mesh import Mesh
from esd.mesh.shapes import icosphere
from esd.nearest import nearest


@pytest.fixture
def truth(blob):
    return np.arange(len(blob.vertices))


def test_a_true_map_is_sure_and_good(blob, truth):
    values = confidence(blob, blob, truth, truth)
    assert values.min() > 0.7
    verdict = judgement(blob, blob, truth, values)
    assert (verdict.verdict, verdict.advice) == ("good", "")
    assert verdict.orientation == pytest.approx(1)
    assert verdict.expected_accuracy == pytest.approx(values.mean())


def test_evidence_is_the_way_missed_and_the_longest_edge(truth):
    mesh = icosphere(3)
    index = np.arange(len(mesh.vertices))
    missed, longest = evidence(mesh, mesh, index, index).T
    np.testing.assert_array_equal(missed, 0)
    side = np.linalg.norm(mesh.vertices[mesh.faces[:, 0]] - mesh.vertices[mesh.faces[:, 1]], axis=1)
    scale = np.sqrt(4 * np.pi)
    assert side.min() / scale * 0.9 < longest.min() <= longest.max() < side.max() / scale * 1.2
    elsewhere = np.zeros_like(index)  # all come back to vertex 0
    missed = evidence(mesh, mesh, index, elsewhere)[:, 0]
    far = np.linalg.norm(mesh.vertices - mesh.vertices[0], axis=1)
    assert missed[far.argmax()] == pytest.approx(2 / scale, rel=0.05)


def test_confidence_falls_where_the_map_is_wrong_and_is_zero_without_a_match(blob, truth):
    generator = np.random.default_rng(0)
    wrong = blob.vertices[:, 0] > 0.5
    index = np.where(wrong, generator.permutation(truth), truth)
    index[3] = -1
    values = confidence(blob, blob, index, truth)
    assert values[wrong].mean() < 0.3 < 0.6 < values[~wrong].mean()
    assert values[3] == 0
    assert judgement(blob, blob, index, values).verdict in ("doubtful", "failed")
    nonsense = generator.permutation(truth)
    values = confidence(blob, blob, nonsense, truth)
    assert judgement(blob, blob, nonsense, values).verdict == "failed"


def test_a_map_to_the_mirror_image_turns_the_surface_over(blob, truth):
    mirror = Mesh(blob.vertices * [-1, 1, 1], blob.faces)  # inside out
    assert orientation(blob, mirror, truth) == pytest.approx(1)  # as the faces are oriented
    outward = Mesh(mirror.vertices, mirror.faces[:, ::-1])
    assert orientation(blob, outward, truth) == pytest.approx(-1)
    values = confidence(blob, outward, truth, truth)
    verdict = judgement(blob, outward, truth, values)
    assert verdict.verdict == "mirrored"
    assert "mirror image" in verdict.advice
    assert judgement(blob, blob, truth, values, turned_over=True).verdict == "mirrored"


def test_vertices_without_a_face_say_nothing_of_a_map(blob, truth):
    values = confidence(blob, blob, truth, truth)
    lone = Mesh(np.concatenate([blob.vertices, np.zeros((999, 3))]), blob.faces)
    index, more = np.append(truth, np.full(999, -1)), np.append(values, np.zeros(999))
    expected = judgement(blob, blob, truth, values)
    assert judgement(lone, blob, index, more) == expected
    assert expected.verdict == "good"


def test_similarity_and_rejection():
    result = with_similarity(
        np.array([[0.0], [3.0]]), np.array([[1.0]]), np.array([0, 0]), margin=5.0
    )
    np.testing.assert_allclose(result.confidence, np.exp([-1 / 5, -4 / 5]))
    kept = result.rejecting(2.5)
    np.testing.assert_array_equal(kept.target_index, [0, -1])
    np.testing.assert_array_equal(kept.is_matched(), [True, False])
    assert kept.confidence[1] == 0


def test_without_margin_similarity_is_relative_to_chance():
    generator = np.random.default_rng(0)
    source, target = generator.standard_normal((300, 4)), generator.standard_normal((200, 4)) + 1
    mean = ((source[:, None] - target) ** 2).sum(axis=2).mean()
    result = with_similarity(source, target, nearest(source, target)[0], margin=None)
    np.testing.assert_allclose(result.confidence, np.exp(-(result.distance**2) / mean))


@pytest.mark.parametrize(
    ("scale", "unit"),
    [
        (1.1, "of one unit of length."),  # people differ
        (0.001, "of different units, a length of 1 in the target 0.001 in the source."),
    ],
)
def test_an_overlap_is_said_with_the_units_that_were_taken(blob, truth, scale, unit):
    verdict = judgement(blob, blob, truth, confidence(blob, blob, truth, truth))
    partial = replace(verdict, overlap=Overlap(0.62, scale, 0.9))
    assert partial.candidate == "part"
    said = "Partial: about 62% of the source has a counterpart; the shapes were taken to be "
    assert partial.advice == said + unit
