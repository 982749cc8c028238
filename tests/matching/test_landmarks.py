import numpy as np
import pytest

from esd.common import InputError
from esd.datasets.bodies import bodies
from esd.matching.landmarks import (
    check_landmarks,
    landmark_rows,
    paired_landmarks,
    read_landmark_pairs,
)
from esd.matching.match import match
from esd.mesh.io.landmarks import Landmarks
from esd.mesh.mesh import Mesh
from esd.mesh.shapes import grid


def test_rows_have_unit_length_and_are_largest_at_their_landmark():
    mesh = grid(20, 20)
    rows = landmark_rows(mesh, np.array([0, 399, 200]))
    np.testing.assert_allclose(np.linalg.norm(rows, axis=1), 1)
    np.testing.assert_array_equal(rows[[0, 399, 200]].argmax(axis=1), [0, 1, 2])


def test_another_component_is_infinitely_far():
    mesh = grid(6, 6)
    two = Mesh(
        np.concatenate([mesh.vertices, mesh.vertices + 5]),
        np.concatenate([mesh.faces, mesh.faces + len(mesh.vertices)]),
    )
    rows = landmark_rows(two, np.array([0]))
    assert (rows[len(mesh.vertices) :] == 0).all()


@pytest.mark.parametrize(
    ("landmarks", "message"),
    [
        (np.zeros((3, 3), int), r"shape \(l, 2\); got int64 \(3, 3\)"),
        (np.zeros((3, 2)), "integers"),
        (np.array([[0, 0], [1, 1], [2, 9]]), "target must be vertices from 0 to 4; got 0 to 9"),
        (np.array([[0, 0], [-1, 1], [2, 2]]), "source must be vertices"),
        (np.array([[0, 0], [0, 0], [2, 2]]), "3 different landmarks or more are needed; got 2"),
        (np.array([[1, 0], [1, 1], [1, 2]]), "3 different landmarks or more are needed; got 1"),
        (np.array([[0, 3], [1, 4], [2, 4]]), "3 different landmarks or more are needed; got 2"),
    ],
)
def test_bad_landmarks_are_refused(landmarks, message):
    with pytest.raises(InputError, match=message):
        check_landmarks(landmarks, 5, 5)


def test_landmarks_are_paired_by_name():
    source = Landmarks(("nose", "ear", "tail", "paw"), np.array([1, 2, 3, -1]))
    target = Landmarks(("tail", "nose", "ear", "paw"), np.array([30, 10, 20, 40]))
    names, pairs = paired_landmarks(source, target)
    assert names == ("nose", "ear", "tail")
    np.testing.assert_array_equal(pairs, [[1, 10], [2, 20], [3, 30]])
    for twice in (("tail", "nose", "ear", "nose"), ("ear", "ear", "tail", "nose")):
        with pytest.raises(InputError, match=r"Several landmarks have the name '(nose|ear)'"):
            paired_landmarks(source, Landmarks(twice, np.array([30, 10, 20, 40])))
    with pytest.raises(InputError, match="a name that both files have; got 0: none"):
        paired_landmarks(source, Landmarks(("x",), np.array([0])))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a,b\n1,2\n", "must have the columns source,target"),
        ("source,target\n1,2\n\n1,x\n", r"line 4, target: expected a whole number; got 'x'"),
        ("source,target\n1\n", r"line 2, target: expected a whole number; the cell is empty"),
        ("source,target\n-1,2\n", r"line 2, source: vertices are counted from 0; got -1"),
        (f"source,target\n{10**30},2\n", r"line 2, source: expected a whole number; got '1000"),
        ("source,target\n", "lists no landmarks"),
        ("source,target\n" + "x" * 200_000, r"pairs.csv' is no CSV file: field larger than"),
    ],
)
def test_bad_pairs_are_refused(tmp_path, text, message):
    path = tmp_path / "pairs.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=message):
        read_landmark_pairs(path)
    with pytest.raises(InputError, match="There is no file"):
        read_landmark_pairs(tmp_path / "none.csv")


def test_a_contradicted_landmark_is_named(blob):
    bend = 0.05 * np.sin(blob.vertices[:, [1, 2, 0]] * 2 + np.arange(3))
    other = Mesh(blob.vertices + bend, blob.faces)
    vertices = np.array([0, 70, 140, 200, 268, 330, 396, 460])
    pairs = np.stack([vertices, vertices], axis=1)
    pairs[3, 1] = 440  # for 200: on the other side of the torus
    found = match(blob, other, landmarks=pairs, mirror="no")
    assert found.judgement.contradicted == (3,)
    gap = np.linalg.norm(other.vertices[found.target_index] - other.vertices, axis=1)
    assert np.median(gap) < 0.1  # a third of an edge around the torus


def test_a_mirror_image_is_matched_by_request(blob):
    mirrored = Mesh(blob.vertices * [-1, 1, 1], blob.faces[:, ::-1])
    found = match(blob, mirrored, mirror="yes")
    assert found.judgement.is_mirrored
    np.testing.assert_array_equal(found.target_index, np.arange(len(blob.vertices)))
    assert not match(blob, mirrored, mirror="no").judgement.is_mirrored
    assert not match(blob, blob).judgement.is_mirrored


def test_shapes_of_two_like_sides_are_not_mirrored(monkeypatch):
    shapes = {shape.name: shape.mesh for shape in bodies(vertex_count=2500).shapes}
    body, other = shapes["s10_p00"](), shapes["s10_p02"]()
    # as if mirror images always fitted clearly better
    monkeypatch.setattr("esd.matching.match._SURE", 1.1)
    monkeypatch.setattr("esd.matching.match._CLEARLY", -1e6)
    assert not match(body, other, candidates=["embedding"]).judgement.is_mirrored
    monkeypatch.setattr("esd.matching.match._SYMMETRIC", 1.1)
    assert match(body, other, candidates=["embedding"]).judgement.is_mirrored
