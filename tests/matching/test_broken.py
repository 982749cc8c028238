"""Maps of broken meshes come back for the vertices of the files."""

import re

import numpy as np
import pytest

from damaged import joined
from esd.common import InputError
from esd.datasets.bodies import bodies
from esd.descriptors.hks import hks
from esd.descriptors.recipe import Descriptor, Recipe, descriptors, gradient_recipe
from esd.learning.model import Model
from esd.matching.match import match
from esd.mesh.mesh import Mesh, PointCloud
from esd.mesh.repair.repair import repair
from esd.mesh.shapes import icosphere
from esd.spectral.spectrum import spectrum

RECIPE = Recipe((Descriptor("hks", 30, log=True),), eigenpairs=100)
MODEL = Model("hks", RECIPE, np.zeros(30), np.ones(30))


@pytest.fixture(autouse=True)
def _few_vertices_around_pieces(monkeypatch):
    """A coarser surface around pieces, which takes a tenth of the time."""
    monkeypatch.setattr("esd.mesh.repair.repair._AROUND", 2000)


def share_of_own(blob: Mesh, broken, original, **options) -> float:
    """Share of the broken shape's vertices that are mapped to themselves on the sound one."""
    found = match(repair(broken, **options), blob, model=MODEL).target_index
    kept = found >= 0
    return float((found[kept] == original[kept]).mean())


def test_each_corner_of_a_torn_mesh_is_mapped(blob, caplog):
    torn = blob.vertices[blob.faces].reshape(-1, 3), np.arange(blob.faces.size).reshape(-1, 3)
    assert share_of_own(blob, torn, blob.faces.ravel()) == 1
    assert "The source has" in caplog.text
    assert "doubled along seams (each is joined with the one at its place)" in caplog.text
    assert "The target" not in caplog.text


def test_what_is_left_out_has_no_match_on_either_side(blob):
    count = len(blob.vertices)
    lump = icosphere(1)
    vertices = np.concatenate([blob.vertices, lump.vertices / 9 + 5, [[7, 7, 7]]])
    vertices[3] = np.nan
    dirty = vertices, np.concatenate([blob.faces, lump.faces + count])
    forth = match(dirty, blob, model=MODEL)
    lost = np.r_[3, count : len(vertices)]
    np.testing.assert_array_equal(np.flatnonzero(~forth.is_matched()), lost)
    assert np.isinf(forth.distance[lost]).all()
    assert (forth.confidence[lost] == 0).all()
    back = match(blob, dirty, model=MODEL)
    assert not np.isin(back.target_index, lost).any()
    assert back.is_matched().all()


def with_pieces(blob: Mesh) -> tuple[Mesh, int]:
    """The blob with a shell of a fifth of it right above its surface, and a ball far away."""
    low = np.unique(blob.faces[: len(blob.faces) // 5])
    shell = blob.vertices[low] * 1.001
    place = np.full(len(blob.vertices), -1)
    place[low] = np.arange(len(low))
    inner = blob.faces[(place[blob.faces] >= 0).all(axis=1)]
    ball = icosphere(2)
    vertices = np.concatenate([blob.vertices, shell, ball.vertices / 9 + 5])
    count = len(blob.vertices)
    faces = [blob.faces, place[inner] + count, ball.faces + count + len(low)]
    return Mesh(vertices, np.concatenate(faces)), len(low)


@pytest.mark.parametrize("coarse", [None, 400])
def test_pieces_beside_the_largest_go_with_it_and_far_ones_count_as_wrong(blob, coarse):
    mesh, shell = with_pieces(blob)
    count = len(blob.vertices)
    found = match(mesh, blob, model=MODEL, coarse=coarse)
    on_shell = slice(count, count + shell)
    share = 162 / len(mesh.vertices)  # the ball's vertices
    assert found.is_matched()[: count + shell].all()
    assert not found.is_matched()[count + shell :].any()
    gap = np.linalg.norm(mesh.vertices[on_shell, None] - mesh.vertices[:count], axis=2)
    nearest = gap.argmin(axis=1)
    np.testing.assert_array_equal(found.target_index[on_shell], found.target_index[nearest])
    alone = match(Mesh(mesh.vertices[:count], blob.faces), blob, model=MODEL, coarse=coarse)
    judged = found.judgement
    assert judged.unmatched == pytest.approx(share)
    assert judged.expected_accuracy == pytest.approx(
        alone.judgement.expected_accuracy * (1 - share)
    )
    assert f"{share:.0%} of the source lies on loose pieces too far off" in judged.advice


def test_touching_pieces_of_a_body_are_matched_together():
    collection = bodies(remeshed=False)
    by_name = {shape.name: shape for shape in collection.shapes}
    source, target = (by_name[name].mesh() for name in ("s10_p01", "s12_p05"))
    # three bands of the body, 1 cm apart; vertex i of one body is vertex i of the other
    bands = np.digitize(source.vertices[source.faces, 2].mean(axis=1), [0.5, 1.2])
    parts, index = [], []
    for band in range(3):
        used, faces = np.unique(source.faces[bands == band], return_inverse=True)
        parts.append(Mesh(source.vertices[used] + [0, 0, 0.01 * band], faces.reshape(-1, 3)))
        index.append(used)
    torn, original = joined(*parts), np.concatenate(index)
    found = match(torn, target, candidates=["embedding"])
    assert found.is_matched().all()
    assert found.judgement.verdict == "good"
    gap = target.vertices[found.target_index] - target.vertices[original]
    assert (np.linalg.norm(gap, axis=1) < 0.1).mean() > 0.9  # 5 % of their height
    assert repair(torn).lost > 0.3  # of the largest piece alone


def test_one_to_one_maps_take_no_vertex_twice_for_pieces_and_seams(blob):
    mesh, _ = with_pieces(blob)
    torn = Mesh(mesh.vertices[mesh.faces].reshape(-1, 3), np.arange(mesh.faces.size).reshape(-1, 3))
    for each in (mesh, torn):
        index = match(each, blob, model=MODEL, one_to_one=True).target_index
        matched = index[index >= 0]
        assert len(np.unique(matched)) == len(matched) == len(blob.vertices)


def test_a_verdict_names_what_was_not_repaired(blob):
    flaps = blob.faces[::4, [1, 0]]  # a third face at edges of the surface
    tips = blob.vertices[flaps].mean(axis=1) * 1.2
    count = len(blob.vertices)
    third = np.column_stack([flaps, count + np.arange(len(flaps))])
    broken = Mesh(np.concatenate([blob.vertices, tips]), np.concatenate([blob.faces, third]))
    found = match(broken, icosphere(3), model=MODEL)
    assert found.judgement.verdict == "failed"
    assert "Not repaired: 256 non-manifold edges, 4 holes in the source." in found.judgement.advice
    bowl = Mesh(blob.vertices, blob.faces[blob.vertices[blob.faces, 0].max(axis=1) < 0.5])
    found = match(icosphere(3), bowl, model=MODEL)
    assert found.judgement.verdict != "good"
    assert re.search(r"Not repaired: \d holes? in the target.", found.judgement.advice)
    assert not match(blob, blob, model=MODEL).judgement.not_repaired


def test_what_would_lie_in_a_hole_goes_to_its_rim_without_confidence(blob):
    far = np.linalg.norm(blob.vertices - blob.vertices[7], axis=1)
    hole = Mesh(blob.vertices, blob.faces[(far[blob.faces] > 0.3).all(axis=1)])
    kept = np.unique(hole.faces)
    forth = match(blob, hole, model=MODEL)
    assert np.isin(forth.target_index, kept).all()
    missing = np.setdiff1d(np.arange(len(blob.vertices)), kept)
    assert (forth.confidence[missing] == 0).sum() >= 5
    assert forth.confidence[missing].mean() < 0.3 < 0.9 < forth.confidence[kept].mean()
    assert far[forth.target_index[missing]].max() < 0.5
    back = match(hole, blob, model=MODEL)
    np.testing.assert_array_equal(np.flatnonzero(back.is_matched()), kept)


def test_a_each_a_repaired_mesh_is_carried_back_whole(blob):
    torn = blob.vertices[blob.faces].reshape(-1, 3), np.arange(blob.faces.size).reshape(-1, 3)
    repaired = repair(torn)
    found = spectrum(repaired.shape, 20).carried(repaired.vertex_index)
    assert found.eigenvectors.shape == (blob.faces.size, 20)
    gram = found.eigenvectors.T @ (found.mass[:, None] * found.eigenvectors)
    np.testing.assert_allclose(gram, np.eye(20), atol=1e-9)
    np.testing.assert_allclose(found.eigenvalues, spectrum(blob, 20).eigenvalues, rtol=1e-9)


def test_points_of_a_sphere_have_its_eigenvalues():
    cloud = PointCloud(icosphere(4).vertices)
    found = spectrum(cloud, 16)
    degree = np.repeat(np.arange(4), 2 * np.arange(4) + 1)
    # unit area; 2,562 points of a cloud are good for about a hundredth
    np.testing.assert_allclose(found.eigenvalues, degree * (degree + 1) * 4 * np.pi, rtol=0.05)
    assert found.zero_modes == 1


def test_points_are_described_and_matched(blob):
    points = np.concatenate([blob.vertices, [[np.nan, 0, 0]], blob.vertices[:1]])
    cloud = points, np.zeros((0, 3), dtype=int)
    found = match(cloud, blob, model=MODEL)
    assert found.target_index[len(blob.vertices)] == -1
    assert found.target_index[-1] == found.target_index[0]
    same = match(cloud, PointCloud(blob.vertices), model=MODEL)
    assert (same.target_index[: len(blob.vertices)] == np.arange(len(blob.vertices))).all()
    assert same.confidence[: len(blob.vertices)].mean() > 0.9
    # the Laplacian of points is another than that of faces
    assert found.confidence.mean() < same.confidence.mean()
    two = PointCloud(np.concatenate([blob.vertices, blob.vertices + 100]))
    assert spectrum(two, 20).zero_modes == 2


def test_points_are_refused_where_faces_are_needed(blob):
    cloud = PointCloud(blob.vertices)
    product = gradient_recipe("chirality", "hks", columns=[10, 50], reach=1, times=[0.01])
    with pytest.raises(InputError, match="Points have no faces, which 'chirality' needs"):
        descriptors(Recipe((product,), eigenpairs=50), cloud)
    with pytest.raises(InputError, match="area of a point cloud is not known"):
        descriptors(Recipe((Descriptor("hks", 9),), eigenpairs=50, unit_area=False), cloud)
    with pytest.raises(InputError, match="300 eigenpairs were asked for"):
        spectrum(PointCloud(blob.vertices[:9]))
    with pytest.raises(InputError, match="cannot be built"):
        spectrum(PointCloud(blob.vertices[:3]), 2)


def test_a_cloud_and_its_mesh_have_nearly_equal_signatures():
    mesh = icosphere(4)
    bent = Mesh(mesh.vertices * [1, 1.5, 2 + 0.3 * mesh.vertices[:, 0].mean()], mesh.faces)
    pair = spectrum(bent, 60), spectrum(PointCloud(bent.vertices), 60)
    first, second = (np.log(hks(each, times=np.array([0.01, 0.05]))) for each in pair)
    assert np.corrcoef(first.ravel(), second.ravel())[0, 1] > 0.99


def test_faces_oriented_at_random_make_no_map_look_mirrored(blob):
    model = Model("m", Recipe((Descriptor("hks", 20),), eigenpairs=40), np.zeros(20), np.ones(20))
    for seed in range(6):  # about half of which are put right the wrong way round at first
        turned = np.random.default_rng(seed).random((len(blob.faces), 1)) < 0.5
        flipped = Mesh(blob.vertices, np.where(turned, blob.faces[:, ::-1], blob.faces))
        found = match(flipped, blob, model=model)
        assert (found.target_index == np.arange(len(blob.vertices))).all()
        assert found.judgement.verdict == "good"
