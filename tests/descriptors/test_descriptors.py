import json
from dataclasses import replace

import numpy as np
import pytest

from esd.common import InputError
from esd.descriptors.geometry import cubic_spline, geometry_vector
from esd.descriptors.gps import gps
from esd.descriptors.hks import heat_times, hks
from esd.descriptors.recipe import Descriptor, Recipe, descriptors, gradient_recipe, single_recipe
from esd.descriptors.sihks import sihks
from esd.descriptors.wks import wave_energies, wks
from esd.mesh.mesh import Mesh
from esd.mesh.shapes import icosphere
from esd.spectral.spectrum import Spectrum, spectrum


@pytest.fixture
def shape_spectrum(blob):
    return spectrum(blob, 60)


def test_hks_integrates_to_the_heat_trace(shape_spectrum):
    times = heat_times(shape_spectrum, count=20)
    trace = np.exp(-np.outer(shape_spectrum.eigenvalues, times)).sum(axis=0)
    np.testing.assert_allclose(
        shape_spectrum.mass @ hks(shape_spectrum, count=20), trace, rtol=1e-9
    )


def test_heat_times_are_as_the_paper_has_them(shape_spectrum):
    times = heat_times(shape_spectrum)
    assert len(times) == 100
    assert times[0] == pytest.approx(4 * np.log(10) / shape_spectrum.eigenvalues[-1])
    assert times[-1] == pytest.approx(4 * np.log(10) / shape_spectrum.eigenvalues[1])
    np.testing.assert_allclose(times[1:] / times[:-1], times[1] / times[0])


def test_wks_integrates_to_one(shape_spectrum):
    assert wks(shape_spectrum).shape == (len(shape_spectrum.mass), 100)
    np.testing.assert_allclose(shape_spectrum.mass @ wks(shape_spectrum), 1, rtol=1e-9)


def test_wave_energies_are_even_in_the_logarithm_of_the_eigenvalue(shape_spectrum):
    low, high = np.log(shape_spectrum.eigenvalues[[1, -1]])
    energies, width = wave_energies(shape_spectrum)
    np.testing.assert_allclose(energies[[0, -1]], [low, high])
    assert width == pytest.approx(7 * (energies[1] - energies[0]))
    np.testing.assert_allclose(np.diff(energies), (high - low) / 99)


def test_gps_is_the_green_function_at_a_distance(shape_spectrum):
    signature = gps(shape_spectrum, count=25)
    mean_square = shape_spectrum.mass @ signature**2
    np.testing.assert_allclose(mean_square, 1 / shape_spectrum.eigenvalues[1:26], rtol=1e-9)


def test_scaling_laws(shape_spectrum):
    large = shape_spectrum.with_area(9.0)
    np.testing.assert_allclose(hks(large), hks(shape_spectrum) / 9, rtol=1e-9)
    np.testing.assert_allclose(wks(large), wks(shape_spectrum) / 9, rtol=1e-9)
    np.testing.assert_allclose(gps(large), gps(shape_spectrum), rtol=1e-9)


def test_sihks_hardly_changes_with_scale(shape_spectrum):
    small = sihks(shape_spectrum)
    for factor in (0.5, 2.0, 4.0):
        change = np.abs(sihks(shape_spectrum.with_area(factor)) - small).max()
        assert (
            change < 0.01 * small.max()
        )  # finite range of times; HKS itself changes by the factor


def test_descriptors_follow_their_vertices(blob):
    order = np.random.default_rng(0).permutation(len(blob.vertices))
    place = np.argsort(order)
    shuffled = Mesh(blob.vertices[order], place[blob.faces])
    for kind in ("hks", "wks", "sihks"):
        recipe = Recipe((Descriptor(kind, 19),), eigenpairs=40)
        ours, theirs = descriptors(recipe, blob), descriptors(recipe, shuffled)
        np.testing.assert_allclose(theirs, ours[order], rtol=1e-6, atol=1e-6 * np.abs(ours).max())


def test_descriptors_do_not_change_with_rigid_motion_and_scale(blob):
    rotation = np.linalg.qr(np.random.default_rng(1).standard_normal((3, 3)))[0]
    moved = Mesh(5 * blob.vertices @ rotation.T + [1, 2, 3], blob.faces)
    recipe = Recipe((Descriptor("hks", 10), Descriptor("wks", 10)), eigenpairs=40)
    np.testing.assert_allclose(descriptors(recipe, moved), descriptors(recipe, blob), rtol=1e-6)
    raw = Recipe(recipe.descriptors, eigenpairs=40, unit_area=False)
    np.testing.assert_allclose(descriptors(raw, moved), descriptors(raw, blob) / 25, rtol=1e-6)


def test_lone_vertices_have_no_descriptor():
    mesh = icosphere(2)
    lone = Mesh(np.concatenate([mesh.vertices, [[9, 9, 9]]]), mesh.faces)
    values = descriptors(Recipe((Descriptor("hks", 5, log=True),), eigenpairs=20), lone)
    assert np.isfinite(values[:-1]).all()
    assert np.isnan(values[-1]).all()


def test_recipes_survive_json():
    recipe = Recipe(
        (Descriptor("hks", 50, log=True), Descriptor("sihks", 9, options={"time_unit": 1e-4}))
    )
    assert Recipe.from_json(json.loads(json.dumps(recipe.to_json()))) == recipe
    assert recipe.width == 59


def test_impossible_descriptors_are_refused(shape_spectrum):
    with pytest.raises(InputError, match="no descriptor 'hsk'"):
        single_recipe("hsk")
    with pytest.raises(InputError, match="no logarithm"):
        single_recipe("gps", log=True)
    with pytest.raises(InputError, match="no descriptor recipe"):
        Recipe.from_json({"eigenpairs": 3})
    with pytest.raises(InputError, match="needs as many non-zero"):
        gps(shape_spectrum, count=60)
    with pytest.raises(InputError, match="positive numbers"):
        hks(shape_spectrum, times=np.array([0.0]))
    with pytest.raises(InputError, match="at least two energies"):
        wks(shape_spectrum, count=1)
    with pytest.raises(InputError, match="1 to 47 frequencies"):
        sihks(shape_spectrum, count=48)


@pytest.mark.parametrize(
    "wrong",
    [{"of": "x"}, {"columns": [100]}, {"columns": 3}, {"reach": 0}, {"times": [-1.0]}, {"more": 1}],
)
def test_impossible_gradient_products_are_refused(wrong):
    part = gradient_recipe("chirality", "hks", columns=range(4), reach=2, times=(1e-3,))
    with pytest.raises(InputError, match="needs the options of"):
        replace(part, options={**part.options, **wrong})
    with pytest.raises(InputError, match="has 5 components; its `count` is 7"):
        replace(part, count=7)


def test_splines_add_up_to_one_between_their_ends():
    x = np.linspace(-3, 3, 601)
    total = sum(cubic_spline(x - i) for i in range(-6, 7))
    np.testing.assert_allclose(total, 1, atol=1e-12)
    assert cubic_spline(np.array([0.0, 1, -1, 2, 5])) == pytest.approx([2 / 3, 1 / 6, 1 / 6, 0, 0])


def test_a_geometry_vector_holds_the_squared_eigenvectors_by_frequency():
    vectors = np.array([[1.0, 2.0], [1.0, -1.0], [1.0, 0.0]])
    shape_spectrum = Spectrum(np.array([0.0, 5.0]), vectors, np.ones(3) / 3, 1)
    values = geometry_vector(shape_spectrum, count=11, largest=10.0)
    expected = np.zeros((3, 11))
    expected[:, :2] = [4, 1]  # the constant mode, of frequency zero
    expected[:, 4:7] = vectors[:, 1:] ** 2 * [1, 4, 1]
    expected /= np.linalg.norm(expected, axis=1, keepdims=True)
    np.testing.assert_allclose(values, expected, atol=1e-12)


def test_geometry_vectors_know_no_signs_and_no_scale(shape_spectrum):
    signs = np.where(np.arange(60) % 3, 1, -1)
    values = geometry_vector(shape_spectrum)
    other = replace(shape_spectrum, eigenvectors=shape_spectrum.eigenvectors * signs).with_area(7.0)
    np.testing.assert_allclose(geometry_vector(other), values, rtol=1e-9, atol=1e-12)
    # by Weyl's law, the last knot lies near the last eigenvalue of any shape
    assert 0.6 < 0.99 * 4 * np.pi * 59 / shape_spectrum.eigenvalues[-1] < 1.5
    for arguments in ({"count": 1}, {"largest": 0.0}):
        with pytest.raises(InputError, match="two components or more and a positive `largest`"):
            geometry_vector(shape_spectrum, **arguments)
