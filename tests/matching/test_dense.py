import numpy as np
import pytest
from scipy.spatial import cKDTree

from esd.common import InputError
from esd.datasets.bodies import bodies
from esd.matching.correspondence import Correspondence
from esd.matching.dense import carried_to_dense
from esd.matching.match import match
from esd.mesh.geometry import edge_lengths, is_referenced, surface_area
from esd.mesh.mesh import Mesh
from esd.mesh.shapes import grid, subdivide
from esd.mesh.surface import SurfacePoints, closest_points
from esd.spectral.coarse import MeshCopy, coarse_copy


def shuffled(mesh: Mesh) -> tuple[Mesh, np.ndarray]:
    """The mesh with its vertices in another order, and a loose one, and the new index of each vertex."""
    order = np.random.default_rng(0).permutation(len(mesh.vertices))
    rank = np.argsort(order)
    return Mesh(np.vstack([mesh.vertices[order], [[9, 9, 9]]]), rank[mesh.faces]), rank


def test_a_right_map_of_copies_is_right_on_the_dense_meshes(blob):
    dense = subdivide(subdivide(blob))  # 8192 vertices
    other, rank = shuffled(dense)
    copies = coarse_copy(dense, 1000), coarse_copy(other, 1200)
    # the truth: where each vertex of one copy lies on the other
    index = cKDTree(copies[1].mesh.vertices).query(copies[0].mesh.vertices)[1]
    image = closest_points(copies[1].mesh, copies[0].mesh.vertices, index)
    match = Correspondence(index, np.zeros(len(index)), np.linspace(0, 1, len(index)))
    found = carried_to_dense(match, image, *copies)
    gap = np.linalg.norm(other.vertices[found.target_index] - dense.vertices, axis=1)
    edge = edge_lengths(dense).mean()
    assert gap.mean() < edge / 2
    assert gap.max() < 3 * edge  # the copies' surfaces differ by their sagitta
    assert (found.target_index == rank).mean() > 0.5
    assert 0 <= found.confidence.min() < found.confidence.max() <= 1
    back = carried_to_dense(
        Correspondence(np.arange(len(copies[1].mesh.vertices)), *np.zeros((2, 1200))),
        closest_points(copies[1].mesh, copies[1].mesh.vertices, np.arange(1200)),
        copies[1],
        copies[1],
    )
    assert back.target_index[-1] == -1
    assert (back.distance[-1], back.confidence[-1]) == (np.inf, 0)
    assert (back.target_index[:-1] == np.arange(8192)).mean() > 0.9


@pytest.mark.parametrize("bend", [0.0, 0.1])
def test_meshes_that_an_affine_motion_makes_equal_are_matched_exactly(blob, bend, monkeypatch):
    dense = subdivide(subdivide(blob))
    other, rank = shuffled(dense)
    places = other.vertices[:, [1, 2, 0]] * [2.0, 1.0, -1.5] + 3
    places[:, 0] += bend * np.sin(10 * places[:, 1])
    other = Mesh(places, other.faces[:, ::-1])  # a mirror image, sheared if not bent
    copies = coarse_copy(dense, 1000), coarse_copy(other, 1200)
    near = cKDTree(other.vertices[rank]).query(copies[1].mesh.vertices)[1]
    index = cKDTree(dense.vertices[near]).query(copies[0].mesh.vertices)[1]
    image = closest_points(copies[1].mesh, copies[1].mesh.vertices[index], index)
    match = Correspondence(index, np.zeros(len(index)), np.ones(len(index)))
    found = carried_to_dense(match, image, *copies).target_index
    monkeypatch.setattr("esd.matching.dense._CONGRUENT", 0.0)
    by_copies = carried_to_dense(match, image, *copies).target_index
    assert 0.2 < (by_copies == rank).mean() < 0.95
    np.testing.assert_array_equal(found, by_copies if bend else rank)


def test_a_body_is_found_again_by_way_of_its_copies():
    body = bodies(remeshed=True).shapes[0].mesh()
    other, _ = shuffled(body)
    found = match(body, other, coarse=2500)
    gap = np.linalg.norm(body.vertices - other.vertices[found.target_index], axis=1)
    assert gap.mean() < 0.01 * np.sqrt(surface_area(body))
    assert found.judgement.verdict == "good"


def test_faces_that_the_map_tears_apart_have_no_vertex_between():
    square = grid(3, 3)
    corners = square.faces
    # on the copy, each dense vertex lies between the first two corners of a face
    middle = np.tile([0.6, 0.4, 0.0], (len(corners), 1))
    places = np.einsum("fc,fck->fk", middle, square.vertices[corners])
    source = MeshCopy(square, places, SurfacePoints(np.arange(len(corners)), middle))
    torn_apart = square.vertices + [[100.0 * (i % 2), 0, 0] for i in range(len(square.vertices))]
    target = coarse_copy(Mesh(torn_apart, corners), 100)
    everywhere = np.arange(len(torn_apart))
    image = closest_points(target.mesh, torn_apart, everywhere)
    match = Correspondence(everywhere, *np.zeros((2, len(everywhere))))
    found = carried_to_dense(match, image, source, target)
    torn = corners[:, 0] % 2 != corners[:, 1] % 2
    assert 0 < torn.sum() < len(corners)
    np.testing.assert_array_equal(found.target_index[torn], corners[torn, 0])


def test_one_to_one_maps_by_copies_are_refused(blob):
    with pytest.raises(InputError, match="are not one-to-one"):
        match(blob, blob, coarse=300, one_to_one=True)


@pytest.mark.usefixtures("subdivided")
def test_coarse_meshes_are_subdivided_and_the_map_is_that_of_their_vertices(blob):
    """Two triangulations of one surface, a third as many vertices as descriptors need."""
    turned = Mesh(blob.vertices[:, [1, 2, 0]], blob.faces)
    found = match(blob, turned, mirror="no")
    assert len(found.target_index) == len(blob.vertices)
    gap = np.linalg.norm(blob.vertices[found.target_index] - blob.vertices, axis=1)
    assert np.median(gap) == 0
    assert found.target_index.max() < len(turned.vertices)


def test_a_subdivided_copy_keeps_values_at_the_vertices(blob):
    from esd.spectral.coarse import fine_copy

    copy = fine_copy(blob, 2000)
    assert len(copy.mesh.vertices) >= 2000
    np.testing.assert_allclose(copy.carried(copy.mesh.vertices), blob.vertices)
    lone = Mesh(np.insert(blob.vertices, 7, 9.0, axis=0), blob.faces + (blob.faces >= 7))
    copy = fine_copy(lone, 2000)
    assert is_referenced(copy.mesh).all()
    assert copy.points.face[7] == -1
    others = np.delete(np.arange(len(lone.vertices)), 7)
    np.testing.assert_allclose(copy.carried(copy.mesh.vertices)[others], blob.vertices)


def test_copies_are_refused_where_there_are_to_be_none(blob):
    with pytest.raises(InputError, match="are not full"):
        match(blob, blob, coarse=400, full=True)
