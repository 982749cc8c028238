import json
from dataclasses import replace

import numpy as np
import pytest

from esd.common import InputError
from esd.descriptors.gps import gps
from esd.descriptors.hks import hks
from esd.descriptors.recipe import (
    Descriptor,
    Recipe,
    descriptors,
    gradient_recipe,
    single_recipe,
    spectrum_descriptors,
)
from esd.descriptors.sihks import sihks
from esd.descriptors.wks import wks
from esd.mesh.mesh import Mesh
from esd.mesh.shapes import icosphere
from esd.spectral.spectrum import spectrum


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


def test_descriptors_in_32_bits_are_those_in_64(blob):
    recipe = Recipe(
        (
            Descriptor("hks", 100, log=True),
            Descriptor("wks", 20),
            gradient_recipe("chirality", "hks", columns=(0, 30, 60), reach=2, times=(0.01, 0.1)),
            gradient_recipe("alignment", "wks", columns=(0, 40), reach=1, times=(0.01,)),
        ),
        eigenpairs=60,
    )
    eigenpairs = spectrum(blob, 60)
    double, single = (
        spectrum_descriptors(recipe, blob, eigenpairs, single=each) for each in (False, True)
    )
    assert double.dtype == np.float64
    assert single.dtype == np.float32
    # rounding of 6e-8, of sums of 60 terms over a gradient that is a tenth of the mean at least
    np.testing.assert_allclose(single, double, atol=1e-5, rtol=1e-5)
