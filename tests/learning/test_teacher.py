import numpy as np
import pytest

from esd.learning.samples import Samples
from esd.learning.teacher import (
    Lesson,
    is_reliable,
    lesson,
    mutually_nearest,
    orientation,
    refined,
    shared_closeness,
)
from esd.mesh.geometry import vertex_normals
from esd.mesh.shapes import icosphere
from esd.spectral.spectrum import spectrum


@pytest.fixture(scope="module")
def sphere():
    """Samples of an ellipsoid, whose descriptors are its coordinates."""
    mesh = icosphere(4)
    mesh = type(mesh)(mesh.vertices * [1.0, 1.2, 1.5], mesh.faces)
    vertices = mesh.vertices.astype(np.float32)
    functions = spectrum(mesh, 40).with_area(1.0).eigenvectors.astype(np.float32)
    every = np.arange(len(vertices))
    return Samples("a", (vertices,), functions, vertices / 4, vertex_normals(mesh), every)


def unit(values):
    return values / np.linalg.norm(values, axis=1, keepdims=True)


def noisy(values):
    noise = np.random.default_rng(len(values)).normal(scale=0.1, size=values.shape)
    return unit(values + noise).astype(np.float32)


def test_both_nearest_rows_follow_from_one_product():
    generator = np.random.default_rng(0)
    source, target = generator.normal(size=(30, 4)), generator.normal(size=(20, 4))
    gap = np.linalg.norm(source[:, None] - target, axis=2)
    forth, back = mutually_nearest(source, target)
    np.testing.assert_array_equal(forth, gap.argmin(axis=1))
    np.testing.assert_array_equal(back, gap.argmin(axis=0))


def test_refinement_makes_a_noisy_map_better(sphere):
    rows = np.arange(0, 2562, 2), np.arange(1, 2562, 2)
    functions = sphere.eigenvectors[rows[0]], sphere.eigenvectors[rows[1]]
    embedded = noisy(sphere.values[0][rows[0]]), noisy(sphere.values[0][rows[1]][::-1])[::-1]
    error = []
    for sizes in ((), (8, 14, 20), (8, 14, 20, 40)):
        forth, _ = refined(functions, embedded, sizes=sizes)
        gap = sphere.positions[rows[1]][forth] - sphere.positions[rows[0]]
        error.append(np.linalg.norm(gap, axis=1).mean())
    assert error[2] < error[1] < 0.6 * error[0]  # the samples alone are 0.02 apart


def test_orientation_is_one_for_rotations_and_minus_one_for_reflections(sphere):
    positions, normals = sphere.positions, sphere.normals
    turn, _ = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))
    turn *= np.linalg.det(turn)
    kept = orientation(positions, normals, positions @ turn, normals @ turn)
    np.testing.assert_allclose(kept, 1, atol=1e-3)
    mirror = turn @ np.diag([1.0, 1.0, -1.0])
    mirrored = orientation(positions, normals, positions @ mirror, normals @ mirror)
    np.testing.assert_allclose(mirrored, -1, atol=1e-3)


def test_orientation_of_random_maps_is_about_zero(sphere):
    order = np.random.default_rng(0).permutation(len(sphere.positions))
    turn = orientation(
        sphere.positions, sphere.normals, sphere.positions[order], sphere.normals[order]
    )
    assert abs(turn.mean()) < 0.02


def test_lessons_keep_only_what_returns_and_is_oriented(sphere):
    sizes, generator = (8, 14, 20), np.random.default_rng(0)
    found = lesson(sphere, sphere, noisy, sizes=sizes, count=800, generator=generator)
    assert is_reliable(found)
    assert found.kept == len(found.source) / 800
    assert found.kept > 0.9
    gap = sphere.positions[found.source] - sphere.positions[found.target]
    assert np.linalg.norm(gap, axis=1).max() < 0.12
    mirrored = Samples(
        "b",
        (sphere.values[0] * np.float32([1, 1, -1]),),
        sphere.eigenvectors,
        sphere.positions,
        sphere.normals,
        sphere.vertices,
    )
    turned = lesson(sphere, mirrored, noisy, sizes=sizes, count=800, generator=generator)
    assert turned.returning > 0.9
    assert turned.oriented < 0.1
    assert not is_reliable(turned)


def test_too_few_matches_are_not_reliable():
    few = np.arange(19)
    assert not is_reliable(Lesson(few, few, 1.0, 1.0, 0.01))


def test_known_points_lead_a_map(sphere):
    generator = np.random.default_rng(0)

    def blind(values):
        return unit(generator.normal(size=(len(values), 3))).astype(np.float32)

    known = {f"{i}": i for i in (0, 700, 1400, 2100)}
    closeness = {
        name: (1 / (np.linalg.norm(sphere.positions - sphere.positions[i], axis=1) + 0.05)).astype(
            np.float32
        )
        for name, i in known.items()
    }
    led = Samples(
        "c",
        sphere.values,
        sphere.eigenvectors,
        sphere.positions,
        sphere.normals,
        sphere.vertices,
        known=known,
        closeness=closeness,
    )
    assert shared_closeness(led, sphere) is None
    sizes = (8, 14, 20)
    astray = lesson(sphere, sphere, blind, sizes=sizes, count=800, generator=generator)
    found = lesson(led, led, blind, sizes=sizes, count=800, generator=generator)
    assert found.kept > 0.9 > 2 * astray.kept
    np.testing.assert_array_equal(led.shared(led), [[0, 700, 1400, 2100]] * 2)
    assert all(len(rows) == 0 for rows in led.shared(sphere))
