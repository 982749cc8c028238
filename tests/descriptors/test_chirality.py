import numpy as np
import pytest

from esd.common import InputError
from esd.descriptors.chirality import gradient_products, neighbour_pairs
from esd.descriptors.recipe import Descriptor, Recipe, descriptors, gradient_recipe
from esd.mesh.mesh import Mesh
from esd.mesh.remesh.remesh import remesh
from esd.mesh.shapes import grid, icosphere
from esd.spectral.spectrum import spectrum

ODD = gradient_recipe("chirality", "hks", columns=(10, 30, 50), reach=2, times=(2e-3, 2e-2))
EVEN = gradient_recipe("alignment", "wks", columns=(10, 30, 50), reach=2, times=(2e-3,))
RECIPE = Recipe((ODD, EVEN), eigenpairs=80)


def mirrored(mesh):
    """The mirror image, its faces outward again."""
    return Mesh(mesh.vertices * [-1, 1, 1], mesh.faces[:, ::-1])


def test_pairs_reach_to_the_next_fields():
    assert neighbour_pairs(4, reach=2).tolist() == [[0, 1], [0, 2], [1, 2], [1, 3], [2, 3]]


def test_products_of_linear_fields_are_sine_and_cosine_of_their_angle():
    mesh = grid(12, 9)
    found = spectrum(mesh, 40)
    x, y, _ = mesh.vertices.T
    fields = np.stack([x, y, 3 * x + 3 * y], axis=1)
    which = np.array([[0, 1], [0, 2], [1, 2]])
    half = np.sqrt(0.5)
    for parity, expected in (("odd", [1, half, -half]), ("even", [0, half, half])):
        values = gradient_products(
            mesh, found, fields, pairs=which, times=np.array([0.001, 0.1]), parity=parity
        )
        # constant densities, which diffusion leaves: only rounding is left
        np.testing.assert_allclose(values, np.tile(expected * 2, (len(x), 1)), atol=1e-7)


def test_a_reflection_changes_the_sign_of_the_odd_and_leaves_the_even(blob):
    here, there = descriptors(RECIPE, blob), descriptors(RECIPE, mirrored(blob))
    odd = ODD.count
    np.testing.assert_allclose(there[:, :odd], -here[:, :odd], atol=1e-6)
    np.testing.assert_allclose(there[:, odd:], here[:, odd:], atol=1e-6)
    assert np.abs(here[:, :odd]).mean() > 0.1


def test_rotation_scale_and_order_of_vertices_change_nothing(blob):
    rotation, _ = np.linalg.qr(np.random.default_rng(0).standard_normal((3, 3)))
    rotation *= np.linalg.det(rotation)
    order = np.random.default_rng(1).permutation(len(blob.vertices))
    back = np.argsort(order)
    moved = Mesh((7 * blob.vertices @ rotation.T)[order], back[blob.faces])
    here, there = descriptors(RECIPE, blob), descriptors(RECIPE, moved)
    np.testing.assert_allclose(there, here[order], atol=1e-6)


def test_faces_that_are_lines_change_little(blob, capped):
    here, there = descriptors(RECIPE, blob), descriptors(RECIPE, capped)[: len(blob.vertices)]
    assert np.abs(there - here).mean() < 0.25 * np.abs(here).mean()


def test_other_triangles_of_a_surface_change_little(blob):
    fine = remesh(blob, 2500, style="even", seed=0)
    coarse = remesh(fine.mesh, 2000, style="stretched", seed=1)
    here = descriptors(RECIPE, fine.mesh)
    there = descriptors(RECIPE, coarse.mesh)[coarse.nearest]
    correlation = [np.corrcoef(a, b)[0, 1] for a, b in zip(here.T, there.T, strict=True)]
    assert min(correlation) > 0.9
    assert np.median(correlation) > 0.98


def test_an_outside_that_is_not_defined_is_refused(blob):
    faces = blob.faces.copy()
    faces[5] = faces[5, ::-1]
    torn = Mesh(blob.vertices, faces)
    found, which = spectrum(torn, 80), neighbour_pairs(2, reach=1)
    with pytest.raises(InputError, match="inconsistently oriented"):
        gradient_products(
            torn, found, torn.vertices[:, :2], pairs=which, times=np.ones(1), parity="odd"
        )
    with pytest.raises(InputError, match="not of one shape"):
        gradient_products(
            blob,
            spectrum(icosphere(2), 10),
            np.zeros((3, 2)),
            pairs=neighbour_pairs(2, reach=1),
            times=np.ones(1),
            parity="odd",
        )


def test_recipes_turn_faces_outward_first(blob):
    faces = blob.faces.copy()
    faces[::3] = faces[::3, ::-1]
    here, there = descriptors(RECIPE, blob), descriptors(RECIPE, Mesh(blob.vertices, faces))
    np.testing.assert_allclose(here, there, atol=1e-6)


def test_an_edge_of_three_faces_is_no_reason_to_refuse(blob):
    fin = np.array([[*blob.faces[0, :2], len(blob.vertices)]])
    vertices = np.concatenate([blob.vertices, blob.vertices[blob.faces[0, :1]] * 1.01])
    finned = descriptors(RECIPE, Mesh(vertices, np.concatenate([blob.faces, fin])))
    whole = descriptors(RECIPE, blob)
    assert np.corrcoef(finned[:-1, : ODD.count].ravel(), whole[:, : ODD.count].ravel())[0, 1] > 0.95


def test_recipes_of_products_are_data():
    assert Recipe.from_json(RECIPE.to_json()).to_json() == RECIPE.to_json()
    assert ODD.count == 3 * 2
    with pytest.raises(InputError, match="no logarithm"):
        Descriptor("chirality", 3, log=True)
