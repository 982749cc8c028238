from dataclasses import replace

import numpy as np
import pytest

from esd.common import InputError
from esd.datasets.parts import part_with
from esd.descriptors.chirality import neighbour_pairs
from esd.descriptors.part import PART_WIDTH, part_descriptors
from esd.descriptors.recipe import (
    Descriptor,
    Recipe,
    descriptors,
    part_recipe,
    recipe_spectrum,
    spectrum_descriptors,
)
from esd.mesh.geodesics import geodesic_graph
from esd.mesh.geometry import face_areas, surface_area
from esd.mesh.mesh import Mesh, PointCloud
from esd.mesh.shapes import icosphere
from esd.mesh.topology import boundary_edges
from esd.spectral.dirichlet import dirichlet_spectrum
from esd.spectral.spectrum import spectrum

LEVELS = slice(0, 134)  # the logarithms of HKS and WKS
RATIOS = slice(134, 173)
SHORT = slice(0, 25)  # the logarithms of HKS at times below 0.05
K = 150


def columns() -> tuple[np.ndarray, np.ndarray]:
    """Which columns are odd products, and which are none of log HKS at times beyond 0.9.

    By then the heat is even but for rounding, which decides on the directions of its gradients.
    """
    heat, waves = neighbour_pairs(14, reach=3), neighbour_pairs(13, reach=3)
    odd, is_late = np.zeros(PART_WIDTH, dtype=bool), np.zeros(PART_WIDTH, dtype=bool)
    end = RATIOS.stop
    for times in (5, 3):
        late = np.tile(heat.max(axis=1) >= 10, times)
        is_late[end : end + len(late)] = late
        count = len(late) + times * len(waves)
        odd[end : end + count] = times == 5
        end += count
    assert end == PART_WIDTH
    return odd, ~is_late


ODD, STEADY = columns()


@pytest.fixture(scope="module")
def bump():
    """A long closed surface without symmetry, of 2,562 vertices."""
    ball = icosphere(4)
    x, y, z = ball.vertices.T
    reach = 1 + 0.3 * x * y + 0.2 * z**3 + 0.15 * np.sin(3 * y + x)
    return Mesh(ball.vertices * [1.0, 1.3, 4.0] * reach[:, None], ball.faces)


@pytest.fixture(scope="module")
def cut(bump):
    """The bump without what lies above a plane: the part, its vertices, and its share of area."""
    keep = bump.vertices[bump.faces].mean(axis=1) @ [0.3, 0.2, 1.0] < 2.0
    part = part_with(bump, keep)
    share = face_areas(bump)[keep].sum() / surface_area(bump)
    assert 0.7 < share < 0.85
    return part.mesh, part.original_index(), share


def test_the_mean_over_both_conditions_is_closer_to_the_whole_than_either(bump, cut):
    part, vertices, share = cut
    whole = part_descriptors(bump, spectrum(bump, K), None)[vertices, LEVELS]
    free, held = spectrum(part, K).with_area(share), dirichlet_spectrum(part, K).with_area(share)
    rim = np.unique(boundary_edges(part))
    away = geodesic_graph(part).distances_to_any(rim) / np.sqrt(surface_area(bump))
    both, neumann, dirichlet = (
        part_descriptors(part, *spectra)[:, LEVELS]
        for spectra in ((free, held), (free, None), (held, None))
    )
    near, far = (away > 0.03) & (away < 0.2), away > 0.2
    for region in (near, far):
        assert region.sum() > 100
        error, *others = (
            np.abs(found - whole)[region].mean() for found in (both, neumann, dirichlet)
        )
        assert error < 0.7 * min(others)


def test_scales_are_those_of_the_whole_if_the_share_of_its_area_is_known(bump, cut):
    part, vertices, share = cut
    recipe = replace(part_recipe(), eigenpairs=K)
    whole = descriptors(recipe, bump)[vertices]
    found = recipe_spectrum(recipe, part)
    assert found.area == pytest.approx(1)
    true, wrong = (
        np.abs(spectrum_descriptors(recipe, part, found.with_area(area)) - whole)[:, SHORT].mean()
        for area in (share, 1.0)
    )
    assert true < 0.5 * wrong


def test_ratios_say_how_far_up_the_boundary_is_felt(bump, cut):
    part, _, share = cut
    recipe = replace(part_recipe(), eigenpairs=K)
    whole = descriptors(recipe, bump)
    assert whole.shape == (len(bump.vertices), PART_WIDTH)
    assert (whole[:, RATIOS] == 0).all()  # there is no boundary
    ratio = spectrum_descriptors(recipe, part, spectrum(part, K).with_area(share))[:, RATIOS]
    heat = ratio[:, :22]  # by time; between zero, and one where Dirichlet conditions leave none
    assert heat.min() > -2e-3  # of the first time, for which 150 eigenpairs are few
    np.testing.assert_allclose(heat[np.unique(boundary_edges(part))], 1, atol=1e-6)
    inside = np.argmax(geodesic_graph(part).distances_to_any(np.unique(boundary_edges(part))))
    assert heat[inside, 0] < 1e-3
    assert heat[inside, -1] > 0.9
    assert (np.diff(heat[inside]) > -1e-3).all()


def test_descriptors_depend_on_neither_pose_unit_nor_which_side_faces_are_seen_from(bump):
    recipe = replace(part_recipe(), eigenpairs=K)
    here = descriptors(recipe, bump)
    turn = np.linalg.qr(np.random.default_rng(0).standard_normal((3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    moved = Mesh(5 * bump.vertices @ turn.T + 1, bump.faces[:, ::-1])
    np.testing.assert_allclose(descriptors(recipe, moved)[:, STEADY], here[:, STEADY], atol=1e-6)


def test_a_mirror_image_differs_in_odd_products_alone(bump):
    recipe = replace(part_recipe(), eigenpairs=K)
    here, mirrored = (
        descriptors(recipe, bump),
        descriptors(recipe, Mesh(bump.vertices * [-1, 1, 1], bump.faces)),
    )
    np.testing.assert_allclose(mirrored[:, STEADY & ~ODD], here[:, STEADY & ~ODD], atol=1e-6)
    np.testing.assert_allclose(mirrored[:, STEADY & ODD], -here[:, STEADY & ODD], atol=1e-6)
    assert np.abs(here[:, STEADY & ODD]).max() > 1


def test_precision_and_vertices_without_faces(bump):
    recipe = replace(part_recipe(), eigenpairs=30)
    mesh = Mesh(np.concatenate([bump.vertices, [[9.0, 9, 9]]]), bump.faces)
    found = spectrum_descriptors(recipe, mesh, recipe_spectrum(recipe, mesh), single=True)
    assert found.dtype == np.float32
    assert np.isnan(found[-1]).all()
    assert np.isfinite(found[:-1]).all()


def test_recipes_of_parts_that_are_none_are_refused(bump):
    assert Recipe.from_json(part_recipe().to_json()) == part_recipe()
    assert part_recipe().is_of_parts
    with pytest.raises(InputError, match=f"has {PART_WIDTH} components; its `count` is 10"):
        Descriptor("parts", 10)
    with pytest.raises(InputError, match="no logarithm"):
        Descriptor("parts", PART_WIDTH, log=True)
    with pytest.raises(InputError, match="'parts' has these options: none"):
        Descriptor("parts", PART_WIDTH, options={"time_unit": 2.0})
    with pytest.raises(InputError, match="no others beside"):
        Recipe((Descriptor("parts", PART_WIDTH), Descriptor("hks", 10)))
    with pytest.raises(InputError, match="no faces, which 'parts' needs"):
        cloud = PointCloud(bump.vertices)
        recipe = replace(part_recipe(), eigenpairs=20)
        spectrum_descriptors(recipe, cloud, spectrum(cloud, 20))
