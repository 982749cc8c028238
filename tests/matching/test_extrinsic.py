import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from esd.matching.extrinsic import aligned, deformed, posed
from esd.mesh.mesh import Mesh
from esd.mesh.shapes import grid, subdivide


def bent(mesh: Mesh, amount: float) -> Mesh:
    shift = np.sin(mesh.vertices[:, [1, 2, 0]] * 2 + np.arange(3))
    return Mesh(mesh.vertices + amount * shift, mesh.faces)


@pytest.fixture
def potato(blob):
    """No symmetry, three different axes."""
    return bent(Mesh(blob.vertices * [1.0, 0.7, 0.5], blob.faces), 0.15)


def test_an_affine_copy_is_aligned_exactly(potato):
    motion = Rotation.from_euler("xyz", [2.0, -1.0, 0.5]).as_matrix() @ np.diag([1.1, 1.0, 0.9])
    other = Mesh(3 * potato.vertices @ motion.T + [5, -2, 1], potato.faces)
    source, target = posed(potato, seed=1), posed(other, seed=2)
    found = aligned(source, target)
    assert found.residual < 1e-3  # of the radius; two samples of the same points
    np.testing.assert_allclose(found.source.points, target.points, atol=5e-3)
    # shapes that fit are left alone
    left = deformed(found.source, target)
    np.testing.assert_allclose(left.points, found.source.points, atol=5e-3)


def test_a_mirror_image_is_aligned_by_a_reflection_only(potato):
    mirrored = Mesh(potato.vertices * [-1, 1, 1], potato.faces[:, ::-1])
    shapes = posed(potato), posed(mirrored)
    plain, reflected = (aligned(*shapes, mirrored=flag) for flag in (False, True))
    assert reflected.residual < 1e-2
    assert plain.residual > 5 * reflected.residual


@pytest.mark.parametrize("turn", [0.0, 1.0])
def test_a_flat_shape_is_aligned_with_its_copy(turn):
    sheet = grid(12, 9)
    linear = Rotation.from_rotvec([0.3, turn, 0.2]).as_matrix()
    pair = [
        posed(Mesh(vertices, sheet.faces), filling=np.zeros(108, dtype=bool))
        for vertices in (sheet.vertices, 5 * sheet.vertices @ linear.T + 1)
    ]
    # no search: half a turn in its plane takes a rectangle onto itself as well
    found = aligned(*pair, matches=[(np.arange(108), np.arange(108))], search=False)
    np.testing.assert_allclose(found.source.points, pair[1].points, atol=1e-3)
    assert np.isfinite(found.source.normals).all()


def test_given_maps_are_starts(potato):
    turn = Rotation.from_euler("xyz", [2.0, -1.0, 0.5]).as_matrix()
    shapes = posed(potato), posed(Mesh(potato.vertices @ turn.T, potato.faces))
    found = aligned(*shapes, matches=[(shapes[0].sample, shapes[0].sample)], search=False)
    np.testing.assert_allclose(found.source.points, shapes[1].points, atol=1e-3)


def test_deformation_brings_a_bent_shape_nearer(potato):
    other = bent(potato, 0.06)
    source, target = posed(potato), posed(other)
    alignment = aligned(source, target)
    before, after = (
        np.linalg.norm(shape.points - target.points, axis=1).mean()
        for shape in (alignment.source, deformed(alignment.source, target))
    )
    assert after < 0.7 * before


def test_boundaries_and_fillings_take_no_part(potato):
    opened = Mesh(potato.vertices, potato.faces[50:])
    filling = np.arange(len(potato.vertices)) >= len(potato.vertices) - 20
    shape = posed(opened, filling=filling)
    assert not shape.usable.all()
    assert not filling[shape.sample].any()


def test_the_alignment_does_not_depend_on_how_shapes_lie(potato):
    other = posed(bent(potato, 0.3))
    found = [
        aligned(posed(Mesh(potato.vertices @ turn.T, potato.faces)), other)
        for turn in Rotation.random(4, random_state=0).as_matrix()
    ]
    for each in found[1:]:
        assert each.residual == pytest.approx(found[0].residual, rel=1e-9)
        np.testing.assert_allclose(each.source.points, found[0].source.points, atol=1e-9)


def test_details_are_fitted_beyond_what_moves_as_a_whole(potato):
    waves = Mesh(potato.vertices + 0.04 * np.sin(3 * potato.vertices[:, [1, 2, 0]]), potato.faces)
    source, target = posed(potato, seed=1), posed(waves, seed=2)
    before, after = (
        np.linalg.norm(shape.points - target.points, axis=1).mean()
        for shape in (source, deformed(source, target))
    )
    assert after < 0.3 * before  # 0.6 without details


def test_other_vertices_of_the_same_surface_displace_nothing(potato):
    source, target = posed(potato), posed(subdivide(potato))
    shift = target.points[: len(source.points)] - source.points  # the frames differ a little
    moved = deformed(source, target).points - source.points - shift
    edge = np.linalg.norm(np.diff(source.points[source.faces[:, :2]], axis=1), axis=2).mean()
    assert np.sqrt((moved**2).sum(axis=1).mean()) < 0.1 * edge
