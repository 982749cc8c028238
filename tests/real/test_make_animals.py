"""The tool that generates animals, on the pack that it is made for."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from esd.common import InputError
from esd.mesh.mesh import Mesh
from esd.mesh.topology import boundary_edges

sys.path.insert(0, str(Path(__file__).parents[2] / "tools"))
import make_animals


@pytest.fixture
def fox(real_data):
    path = real_data / "characters" / "animals_pack" / "Fox.glb"
    if not path.exists():
        pytest.skip(f"there is no {path}")
    return make_animals.subdivided(make_animals.read_rig(path))


def still(rig):
    return [Rotation.identity()] * len(rig.names)


def test_the_rig_is_closed_and_its_weights_are_shares(fox):
    assert len(boundary_edges(Mesh(fox.vertices, fox.faces))) == 0
    assert fox.weights.min() >= 0
    np.testing.assert_allclose(fox.weights.sum(axis=1), 1)
    assert fox.parents[fox.names.index("IKFrontLeg.L")] == fox.names.index("FrontLowerLeg.L")


def test_an_animal_as_it_was_drawn_stays_as_it_is(fox):
    motions = np.linalg.inv(fox.unbind)
    found = make_animals.posed(fox, motions, np.ones((len(fox.names), 3)), still(fox))
    np.testing.assert_allclose(found, fox.vertices, atol=1e-6 * np.ptp(fox.vertices))


def test_longer_tails_carry_their_ends(fox):
    motions = np.linalg.inv(fox.unbind)
    sizes = np.ones((len(fox.names), 3))
    sizes[[name.startswith("Tail") for name in fox.names], 1] = 2
    found = make_animals.posed(fox, motions, sizes, still(fox))
    grown = np.linalg.norm(found - fox.vertices, axis=1)
    tail = [name.startswith("Tail") for name in fox.names]
    elsewhere = fox.weights[:, tail].sum(axis=1) == 0
    assert grown[elsewhere].max() < 1e-6 * np.ptp(fox.vertices)
    assert grown.max() > 0.3 * np.ptp(fox.vertices[fox.weights[:, tail].sum(axis=1) > 0.9])


def test_equal_seeds_give_equal_animals_registered_with_their_own_kind(fox):
    first, second = (make_animals.animals([fox], builds=2, seed=3) for _ in range(2))
    assert [shape.template for shape in first.shapes] == ["fox", "fox"]
    for one, other in zip(first.shapes, second.shapes, strict=True):
        np.testing.assert_array_equal(one.mesh().vertices, other.mesh().vertices)
    a, b = first.shapes
    assert len(a.correspondence()) == len(b.correspondence()) == len(fox.vertices)
    assert a.mesh().vertices.shape != b.mesh().vertices.shape


def test_a_file_whose_bones_never_move_is_refused(real_data):
    with pytest.raises(InputError, match="has no skeleton that is animated"):
        make_animals.read_rig(real_data / "hands" / "left.glb")
