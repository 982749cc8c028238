import numpy as np
import pytest
from scipy.spatial import KDTree

from esd.common import InputError
from esd.deformation.elastic import elastic
from esd.deformation.fit import Fit, fit, is_inverted, without_inverted
from esd.mesh.mesh import Mesh, PointCloud
from esd.mesh.shapes import subdivide, torus
from esd.registration.quality import distance_to, quality


@pytest.fixture(scope="module")
def template() -> Mesh:
    return subdivide(torus(16, 10))


def bent(mesh: Mesh) -> Mesh:
    x, y, z = mesh.vertices.T
    return Mesh(np.stack([x, y, z + 0.2 * x**2], axis=1), mesh.faces)


def test_a_template_lies_on_the_surface_of_a_bent_scan(template):
    scan = bent(subdivide(template))
    index = np.arange(len(template.vertices))  # the first vertices of a subdivided mesh
    found = fit(template, scan, index, np.ones(len(index)))
    figures = quality(template, scan, found)
    assert figures.relative_distance < 0.002
    assert figures.inverted == 0
    assert figures.supported == 1.0
    # beside 0.01 √area, over which the last round is stiff
    assert np.abs(found.vertices - scan.vertices[index]).max() < 0.05


def test_wrong_matches_are_outvoted(template):
    scan = bent(template)
    index = np.arange(len(template.vertices))
    wrong = np.random.default_rng(0).choice(len(index), len(index) // 10, replace=False)
    index[wrong] = np.roll(index[wrong], 1)
    found = fit(template, scan, index, np.ones(len(index)))
    gap = np.linalg.norm(found.vertices - scan.vertices, axis=1)
    assert np.median(gap) < 0.03
    assert quality(template, scan, found).inverted == 0


def test_where_the_scan_has_nothing_the_template_is_carried_on(template):
    kept = (template.vertices[template.faces][:, :, 0] < 0.5).all(axis=1)
    scan = Mesh(template.vertices, template.faces[kept])
    covered = np.zeros(len(template.vertices), dtype=bool)
    covered[scan.faces] = True
    index = np.where(covered, np.arange(len(covered)), -1)
    found = fit(template, scan, index, covered.astype(float))
    assert not found.supported[template.vertices[:, 0] > 1.0].any()
    # nothing moved: what is missing is the template's own
    assert np.abs(found.vertices - template.vertices).max() < 0.1


def test_matches_of_a_missing_half_with_the_other_half_are_given_up(template):
    kept = (template.vertices[template.faces][:, :, 0] < 0.5).all(axis=1)
    scan = Mesh(template.vertices, template.faces[kept])
    covered = np.zeros(len(template.vertices), dtype=bool)
    covered[scan.faces] = True
    reflected = template.vertices * [-1.0, 1.0, 1.0]
    other = KDTree(np.where(covered[:, None], template.vertices, 9.0)).query(reflected)[1]
    index = np.where(covered, np.arange(len(covered)), other)
    found = fit(template, scan, index, np.where(covered, 1.0, 0.7))
    far = template.vertices[:, 0] > 1.0
    assert not found.supported[far].any()
    assert found.supported[template.vertices[:, 0] < 0].mean() > 0.95
    assert np.abs(found.vertices - template.vertices)[far].max() < 0.4


def test_points_are_scans_as_well(template):
    moved = template.vertices + np.array([0.0, 0.0, 1.0])
    index = np.arange(len(moved))
    found = fit(template, PointCloud(moved), index, np.full(len(index), np.nan))
    assert distance_to(PointCloud(moved), found.vertices).mean() < 0.01


def test_what_of_a_scan_the_template_does_not_reach_is_not_covered(template):
    far = template.vertices + np.array([20.0, 0.0, 0.0])
    faces = np.concatenate([template.faces, template.faces + len(far)])
    both = Mesh(np.concatenate([template.vertices, far]), faces)
    fitted = Fit(template.vertices, np.ones(len(far), dtype=bool), 1.0)
    assert quality(template, both, fitted).covered == pytest.approx(0.5)
    assert quality(template, PointCloud(both.vertices), fitted).covered == pytest.approx(0.5)
    assert quality(template, template, fitted).covered == pytest.approx(1.0)


def test_a_start_takes_the_place_of_a_map(template):
    scan = Mesh(template.vertices + np.array([0.0, 0.0, 0.02]), template.faces)
    none = np.full(len(template.vertices), -1)
    found = fit(template, scan, none, np.zeros(len(none)), start=template.vertices)
    assert quality(template, scan, found).relative_distance < 0.002
    with pytest.raises(InputError, match="No vertex of the template has a match"):
        fit(template, scan, none, np.zeros(len(none)))
    few = np.where(np.arange(len(none)) < 9, np.arange(len(none)) % 2, -1)
    with pytest.raises(InputError, match="leads to 2 vertices of the scan; 3 or more are needed"):
        fit(template, scan, few, np.ones(len(none)))


def test_shapes_without_a_size_are_refused(template):
    index, sure = np.arange(len(template.vertices)), np.ones(len(template.vertices))
    flat = Mesh(template.vertices * [1, 0, 0], template.faces)
    with pytest.raises(InputError, match="faces of the template have no area"):
        fit(flat, template, index, sure)
    with pytest.raises(InputError, match=r"What is matched has no size: .* on the scan"):
        fit(template, flat, index, sure)
    with pytest.raises(InputError, match="What is matched has no size"):
        fit(template, PointCloud(0 * template.vertices), index, sure)


def test_a_face_is_inverted_where_a_vertex_is_pushed_across_its_neighbours():
    x, y = np.meshgrid(np.arange(5.0), np.arange(5.0))
    vertices = np.stack([x.ravel(), y.ravel(), np.zeros(25)], axis=1)
    corner = np.array([5 * r + c for r in range(4) for c in range(4)])
    faces = np.concatenate(
        [
            np.stack([corner, corner + 1, corner + 6], axis=1),
            np.stack([corner, corner + 6, corner + 5], axis=1),
        ]
    )
    assert not is_inverted(Mesh(vertices, faces)).any()
    vertices[12, 0] += 1.5  # past the vertex beside it
    assert is_inverted(Mesh(vertices, faces)).any()


def test_faces_that_are_inverted_at_rest_are_not_counted(template):
    vertices = template.vertices.copy()
    a, b = template.faces[0, :2]
    vertices[a] += 1.5 * (vertices[b] - vertices[a])  # past the vertex beside it
    folded = Mesh(vertices, template.faces)
    assert is_inverted(folded).any()
    index = np.arange(len(vertices))
    found = fit(folded, folded, index, np.ones(len(index)))
    assert is_inverted(Mesh(found.vertices, template.faces)).any()
    assert quality(folded, folded, found).inverted == 0


def test_crumpled_faces_are_turned_back(template):
    generator = np.random.default_rng(0)
    near = np.linalg.norm(template.vertices - template.vertices[0], axis=1) < 0.6
    assert 20 < near.sum() < len(near) / 4
    noise = 0.1 * generator.normal(size=template.vertices.shape)
    crumpled = np.where(near[:, None], template.vertices + noise, template.vertices)
    before = is_inverted(Mesh(crumpled, template.faces))
    assert before.sum() > 10
    found = without_inverted(elastic(template), crumpled, template.faces)
    assert not is_inverted(Mesh(found, template.faces)).any()
    far = np.linalg.norm(template.vertices - template.vertices[0], axis=1) > 1.5
    assert (found[far] == template.vertices[far]).all()


def test_no_vertex_is_moved_far_to_turn_faces_back(template):
    # on one side a little, on the other beyond repair
    gap = np.linalg.norm(template.vertices - template.vertices[0], axis=1)[:, None]
    strength = np.where(gap < 0.6, 0.1, 0.0) + np.where(gap > gap.max() - 0.6, 0.5, 0.0)
    noise = strength * np.random.default_rng(0).normal(size=template.vertices.shape)
    crumpled = template.vertices + noise
    body = elastic(template)
    found = without_inverted(body, crumpled, template.faces)
    before, after = (is_inverted(Mesh(v, template.faces)).sum() for v in (crumpled, found))
    assert 0 < after < before
    moved = np.linalg.norm(found - crumpled, axis=1)
    assert 0 < moved.max() <= 0.1 * body.unit


def test_a_start_keeps_the_scale_that_it_is_given(template):
    doubled = Mesh(2 * template.vertices, template.faces)
    none = np.full(len(template.vertices), -1)
    found = fit(
        template, doubled, none, np.zeros(len(none)), start=doubled.vertices + 0.03, scale=2.0
    )
    assert found.scale == 2.0
    assert quality(template, doubled, found).stretch == pytest.approx((1, 1, 1), abs=0.03)


def test_a_scale_that_is_known_does_not_follow_from_the_map(template):
    index = np.arange(len(template.vertices))
    found = fit(template, template, index, np.ones(len(index)), scale=1.1, quick=True)
    assert found.scale == 1.1
