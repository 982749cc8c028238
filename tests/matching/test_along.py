from dataclasses import replace

import numpy as np
import pytest

from esd.common import InputError
from esd.matching.along import transfer, transferred_texture
from esd.matching.correspondence import Correspondence
from esd.matching.transfer import carried_texture
from esd.mesh.mesh import Mesh, PointCloud


def identity(count: int) -> Correspondence:
    return Correspondence(np.arange(count), np.zeros(count), np.ones(count))


def flat_shaded(mesh: Mesh) -> tuple[Mesh, np.ndarray]:
    """The mesh with corners of its own for each face, and the vertex that each corner was."""
    corners = mesh.faces.ravel()
    return Mesh(mesh.vertices[corners], np.arange(len(corners)).reshape(-1, 3)), corners


def test_a_target_whose_faces_have_corners_of_their_own_gets_all_labels(blob):
    target, corners = flat_shaded(blob)
    first = np.unique(corners, return_index=True)[1]
    match = replace(identity(len(blob.vertices)), target_index=first)
    labels = np.arange(len(blob.vertices))
    np.testing.assert_array_equal(transfer(labels, blob, target, match), labels[corners])
    values = transfer(blob.vertices, blob, target, match)
    np.testing.assert_allclose(values, target.vertices, atol=1e-9)  # barycentric weights of 1
    of_faces = transfer(np.arange(len(blob.faces)), blob, target, match)
    np.testing.assert_array_equal(of_faces, np.arange(len(blob.faces)))


def test_a_source_whose_faces_have_corners_of_their_own_gives_all_labels(blob):
    source, corners = flat_shaded(blob)
    match = replace(identity(len(corners)), target_index=corners)
    found = transfer(corners, source, blob, match)
    np.testing.assert_array_equal(found, np.arange(len(blob.vertices)))
    # only the last corner at each place is matched: it speaks for those it is joined with
    last = len(corners) - 1 - np.unique(corners[::-1], return_index=True)[1]
    some = np.where(np.isin(np.arange(len(corners)), last), corners, -1)
    found = transfer(corners, source, blob, replace(match, target_index=some))
    np.testing.assert_array_equal(found, np.arange(len(blob.vertices)))


def test_textures_follow_faces_that_the_repair_flips(blob):
    flipped = np.random.default_rng(0).random(len(blob.faces)) < 0.3
    source = Mesh(blob.vertices, np.where(flipped[:, None], blob.faces[:, ::-1], blob.faces))
    match = identity(len(blob.vertices))
    coordinates = np.random.default_rng(1).random((len(blob.vertices), 2))
    carried = transferred_texture(coordinates[source.faces], source, blob, match)
    np.testing.assert_allclose(carried, carried_texture(coordinates[blob.faces], blob, blob, match))
    np.testing.assert_allclose(carried, coordinates[blob.faces], atol=1e-9)
    with pytest.raises(InputError, match="Expected texture coordinates of shape"):
        transferred_texture(coordinates, source, blob, match)
    with pytest.raises(InputError, match="Textures lie on faces"):
        transferred_texture(
            np.zeros((0, 3, 2)), PointCloud(blob.vertices), blob, identity(len(blob.vertices))
        )


def test_points_give_and_take(blob):
    points, count = PointCloud(blob.vertices), len(blob.vertices)
    labels = np.arange(count)
    for source, target in ((points, blob), (blob, points), (points, points)):
        np.testing.assert_array_equal(transfer(labels, source, target, identity(count)), labels)
    with pytest.raises(InputError, match="Labels of faces need faces on both"):
        transfer(np.arange(len(blob.faces)), blob, points, identity(count))


def test_vertices_that_cannot_be_used_get_nothing(blob):
    vertices = blob.vertices.copy()
    vertices[3] = np.nan
    found = transfer(
        np.arange(len(vertices)), blob, (vertices, blob.faces), identity(len(vertices))
    )
    assert found[3] == -1
    assert (np.delete(found, 3) >= 0).all()
    values = transfer(blob.vertices, blob, (vertices, blob.faces), identity(len(vertices)))
    assert np.isnan(values[3]).all()


def test_landmarks_follow_the_map_and_misfits_are_refused(blob):
    count = len(blob.vertices)
    match = replace(identity(count), target_index=np.arange(count)[::-1])
    assert transfer([0, 5], blob, blob, match, kind="landmarks").tolist() == [count - 1, count - 6]
    for data, pair, fault in (
        (np.zeros(3), (blob, blob), "Expected one of the values for each vertex"),
        (np.zeros(3, dtype=int), (blob, blob), "Expected one of the labels for each vertex"),
    ):
        with pytest.raises(InputError, match=fault):
            transfer(data, *pair, match)
    with pytest.raises(InputError, match="The map has 3 vertices; the source has"):
        transfer(np.zeros(count), blob, blob, identity(3))
    with pytest.raises(InputError, match="names target vertex"):
        transfer(np.zeros(count), blob, blob, replace(match, target_index=np.full(count, count)))
    with pytest.raises(InputError, match="no match between usable parts"):
        transfer(np.zeros(count), blob, blob, replace(match, target_index=np.full(count, -1)))
