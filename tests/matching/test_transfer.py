import numpy as np
import pytest

from esd.common import InputError
from esd.matching.correspondence import Correspondence
from esd.matching.transfer import (
    aligned_image,
    carried_labels,
    carried_landmarks,
    carried_texture,
    carried_values,
    face_places,
    in_between,
    vertex_places,
)
from esd.mesh.geometry import vertex_areas
from esd.mesh.mesh import Mesh
from esd.mesh.shapes import grid, icosphere, subdivide


def exact(target_index) -> Correspondence:
    index = np.asarray(target_index)
    return Correspondence(index, np.zeros(len(index)), np.ones(len(index)))


@pytest.fixture
def coarse() -> Mesh:
    return grid(9, 7)


@pytest.fixture
def fine(coarse) -> Mesh:
    """The same rectangle with four times the faces; its first vertices are the coarse ones."""
    return subdivide(coarse)


def test_linear_values_are_carried_exactly(coarse, fine):
    match = exact(np.arange(len(coarse.vertices)))
    values = coarse.vertices[:, :2] @ np.array([[2.0, 1.0], [-1.0, 3.0]])
    carried = carried_values(values, coarse, vertex_places(coarse, fine, match))
    expected = fine.vertices[:, :2] @ np.array([[2.0, 1.0], [-1.0, 3.0]])
    np.testing.assert_allclose(carried, expected, atol=1e-12)


def test_nearest_takes_the_value_of_a_vertex(coarse, fine):
    match = exact(np.arange(len(coarse.vertices)))
    places = vertex_places(coarse, fine, match, method="nearest")
    carried = carried_values(coarse.vertices[:, 0], coarse, places)
    assert set(carried) == set(coarse.vertices[:, 0])
    assert np.abs(carried - fine.vertices[:, 0]).max() <= 0.5 / 8 + 1e-12  # half an edge


def test_labels_of_vertices_and_faces_are_carried(coarse, fine):
    match = exact(np.arange(len(coarse.vertices)))
    labels = (coarse.vertices[:, 0] > 0.55).astype(int) + 4
    carried = carried_labels(labels, coarse, vertex_places(coarse, fine, match))
    far = np.abs(fine.vertices[:, 0] - 0.5625) > 0.07
    np.testing.assert_array_equal(carried[far], (fine.vertices[far, 0] > 0.55) + 4)
    # each face is cut in four
    quarters = face_places(coarse, fine, match).face
    np.testing.assert_array_equal(quarters, np.tile(np.arange(len(coarse.faces)), 4))


def test_of_vertices_with_one_image_the_best_match_speaks():
    mesh = grid(3, 3)
    index = np.arange(9)
    index[4] = 0
    distance = np.zeros(9)
    distance[0] = 1.0  # vertex 0 and vertex 4 are both mapped to 0; 4 is the better match
    match = Correspondence(index, distance, np.ones(9))
    places = vertex_places(mesh, mesh, match, method="nearest")
    assert carried_values(np.arange(9.0), mesh, places)[0] == 4


def test_parts_out_of_reach_get_nothing():
    one = icosphere(1)
    both = Mesh(
        np.concatenate([one.vertices, one.vertices + 5]),
        np.concatenate([one.faces, one.faces + 42]),
    )
    match = exact(np.arange(42))
    places = vertex_places(one, both, match)
    values = carried_values(np.ones(42), one, places)
    np.testing.assert_array_equal(np.isnan(values), np.arange(84) >= 42)
    assert set(carried_labels(np.full(42, 7), one, places)[42:]) == {-1}
    assert set(face_places(one, both, match).face[80:]) == {-1}
    with pytest.raises(InputError, match="no match on any"):
        carried_texture(np.zeros((80, 3, 2)), one, both, match)


def test_a_map_to_one_vertex_carries_one_value(coarse):
    places = vertex_places(coarse, coarse, exact(np.full(63, 5)))
    assert len(set(carried_values(np.arange(63.0), coarse, places))) == 1


def test_a_face_that_the_map_tears_carries_nothing():
    """One vertex of a sphere is mapped to the other side: values there do not leak through."""
    sphere = icosphere(3)
    index = np.arange(len(sphere.vertices))
    low = int(sphere.vertices[:, 2].argmin())
    index[sphere.vertices[:, 2].argmax()] = low
    values = sphere.vertices[:, 2].copy()
    distance = np.zeros(len(index))
    distance[sphere.vertices[:, 2].argmax()] = 1
    places = vertex_places(sphere, sphere, Correspondence(index, distance, distance))
    carried = carried_values(values, sphere, places)
    assert np.abs(carried - values).max() < 0.05  # an edge is 0.15 long


def test_texture_goes_on_across_a_seam():
    """A tube unrolled on an image: no face of the target may span the whole image."""
    around, along = 24, 8
    u, v = np.meshgrid(np.arange(around), np.arange(along), indexing="ij")
    angle = 2 * np.pi * u / around
    vertices = np.stack([np.cos(angle), np.sin(angle), 0.25 * v], axis=2).reshape(-1, 3)

    def corners(i, j):
        a, b = i, i + 1
        quad = [(a, j), (b, j), (b, j + 1), (a, j), (b, j + 1), (a, j + 1)]
        index = [(p % around) * along + q for p, q in quad]
        return index, [(p / around, q / (along - 1)) for p, q in quad]

    parts = [corners(i, j) for i in range(around) for j in range(along - 1)]
    faces = np.array([part[0] for part in parts]).reshape(-1, 3)
    coordinates = np.array([part[1] for part in parts]).reshape(-1, 3, 2)
    source = Mesh(vertices, faces)
    target = subdivide(source)
    carried = carried_texture(coordinates, source, target, exact(np.arange(len(vertices))))
    span = np.ptp(carried[:, :, 0], axis=1)
    assert span.max() < 1.01 / around
    expected = np.arctan2(target.vertices[:, 1], target.vertices[:, 0]) / (2 * np.pi)
    off = carried[:, :, 0] - expected[target.faces]
    assert np.abs(off - np.round(off)).max() < 1e-2  # midpoints of edges lie inside the circle


def test_landmarks_go_where_the_map_says():
    match = exact([5, -1, 2])
    np.testing.assert_array_equal(carried_landmarks([2, 1, 0, -1], match), [2, -1, 5, -1])
    with pytest.raises(InputError, match="from 0 to 2; got 0 to 3"):
        carried_landmarks([0, 3], match)


def test_a_moved_shape_is_moved_back(blob):
    rotation = np.linalg.qr(np.random.default_rng(1).standard_normal((3, 3)))[0]
    rotation *= np.sign(np.linalg.det(rotation))
    moved = Mesh(blob.vertices @ rotation + [3, 4, 5], blob.faces)
    index = np.arange(len(blob.vertices))
    index[7] = -1
    back = aligned_image(blob, moved, exact(index))
    np.testing.assert_allclose(back, blob.vertices, atol=1e-9)


def test_in_between_starts_at_the_source_and_ends_at_its_image(blob):
    stretched = Mesh(blob.vertices * [1, 1, 2], blob.faces)
    shapes = in_between(blob, stretched, exact(np.arange(len(blob.vertices))), count=3)
    np.testing.assert_array_equal(shapes[0].vertices, blob.vertices)
    np.testing.assert_allclose(
        shapes[1].vertices, (shapes[0].vertices + shapes[2].vertices) / 2, atol=1e-12
    )
    weights = vertex_areas(blob)
    np.testing.assert_allclose(
        weights @ shapes[2].vertices, weights @ blob.vertices, atol=1e-9
    )  # the centre stays
    with pytest.raises(InputError, match="two or more"):
        in_between(blob, blob, exact(np.arange(len(blob.vertices))), count=1)


def test_what_does_not_fit_is_refused(coarse):
    places = vertex_places(coarse, coarse, exact(np.arange(63)))
    with pytest.raises(InputError, match="value for each vertex of the source, 63 in all; got 3"):
        carried_values(np.ones(3), coarse, places)
    with pytest.raises(InputError, match="label for each vertex of the source"):
        carried_labels(np.ones(3, dtype=int), coarse, places)
    with pytest.raises(InputError, match="map has 3 vertices; the source mesh has 63"):
        vertex_places(coarse, coarse, exact([0, 1, 2]))
    with pytest.raises(InputError, match="names target vertex 63"):
        vertex_places(coarse, coarse, exact(np.arange(1, 64)))
    with pytest.raises(InputError, match="no match"):
        vertex_places(coarse, coarse, exact(np.full(63, -1)))
    lone = Mesh(np.concatenate([coarse.vertices, [[9, 9, 9]]]), coarse.faces)
    only_lone = np.full(64, -1)
    only_lone[63] = 0
    with pytest.raises(InputError, match="No face of the source has a match"):
        vertex_places(lone, coarse, exact(only_lone))
