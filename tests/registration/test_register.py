"""Templates registered to scans of which every vertex is known."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import esd
from esd.common import InputError
from esd.matching.correspondence import Correspondence
from esd.mesh.geometry import is_referenced
from esd.mesh.mesh import Mesh, PointCloud
from esd.registration import register as registering


def bent(mesh: Mesh) -> Mesh:
    """The mesh bent about its second axis, turned by a right angle, and moved."""
    x, y, z = (mesh.vertices - mesh.vertices.mean(axis=0)).T
    angle = 0.4 * x / np.ptp(x)
    vertices = np.stack([x * np.cos(angle) - z * np.sin(angle), y, z + x * np.sin(angle)], axis=1)
    return Mesh(vertices[:, [1, 2, 0]] + [5.0, 0.0, 0.0], mesh.faces)


def identity(mesh: Mesh) -> Correspondence:
    count = len(mesh.vertices)
    return Correspondence(np.arange(count), np.zeros(count), np.ones(count))


def misses(found: Mesh, truth: Mesh) -> np.ndarray:
    extent = np.ptp(truth.vertices, axis=0).max()
    return np.linalg.norm(found.vertices - truth.vertices, axis=1) / extent


def test_a_template_with_a_true_map_comes_to_lie_on_the_scan(blob):
    scan = bent(blob)
    found = esd.register(blob, scan, correspondence=identity(blob))
    assert np.array_equal(found.mesh.faces, blob.faces)
    assert misses(found.mesh, scan).mean() < 0.01  # the edges are about 0.03 long
    assert found.quality.relative_distance < 0.002
    assert found.quality.inverted == 0
    assert found.supported.mean() > 0.99
    assert "0 faces inverted" in repr(found)


def test_scrambled_matches_are_overruled_by_the_others(blob):
    scan, truth = bent(blob), identity(blob)
    index = truth.target_index.copy()
    wrong = np.random.default_rng(0).choice(len(index), len(index) // 10, replace=False)
    index[wrong] = np.roll(wrong, 1)
    scrambled = Correspondence(index, truth.distance, truth.confidence)
    found = esd.register(blob, scan, correspondence=scrambled)
    assert misses(found.mesh, scan).mean() < 0.02
    assert misses(found.mesh, scan)[wrong].mean() < 0.03


def test_what_a_scan_lacks_is_carried_on(blob):
    truth = bent(blob)
    high = truth.vertices[:, 1] > np.quantile(truth.vertices[:, 1], 0.85)
    scan = Mesh(truth.vertices, truth.faces[~high[truth.faces].any(axis=1)])
    there = is_referenced(scan)
    match = Correspondence(
        np.where(there, np.arange(len(there)), -1), np.zeros(len(there)), np.ones(len(there))
    )
    found = esd.register(blob, scan, correspondence=match)
    assert not found.supported[high].any()
    assert misses(found.mesh, truth)[there].mean() < 0.01
    assert misses(found.mesh, truth)[high].mean() < 0.05
    assert found.quality.inverted == 0


def test_a_scan_may_be_points(blob):
    scan = bent(blob)
    found = esd.register(blob, PointCloud(scan.vertices), correspondence=identity(blob))
    assert misses(found.mesh, scan).mean() < 0.01


def turned(mesh: Mesh, angle: float) -> Mesh:
    rotation = Rotation.from_euler("z", angle).as_matrix()
    return Mesh(mesh.vertices @ rotation.T, mesh.faces)


def test_frames_start_from_the_last_and_only_lost_ones_are_matched(blob, monkeypatch):
    matched = []

    def true(template, scan, **options):
        matched.append(1)
        return identity(blob)

    monkeypatch.setattr(registering, "match", true)
    # frames that turn on by a little, the next to last one by too much to follow
    angles = [0.0, 0.05, 0.1, 1.5, 1.55]
    scans = [turned(bent(blob), angle) for angle in angles]
    found = list(esd.register_sequence(blob, iter(scans)))
    assert [each.match is not None for each in found] == [True, False, False, True, False]
    assert len(matched) == 2
    for each, scan in zip(found, scans, strict=True):
        assert misses(each.mesh, scan).mean() < 0.02
        assert each.quality.inverted == 0
        assert each.scale == pytest.approx(1.0, rel=0.02)


def test_what_does_not_fit_is_refused(blob):
    scan, truth = bent(blob), identity(blob)
    with pytest.raises(InputError, match="a surface is needed"):
        esd.register(PointCloud(blob.vertices), scan, correspondence=truth)
    short = Correspondence(truth.target_index[:5], truth.distance[:5], truth.confidence[:5])
    with pytest.raises(InputError, match="The map has 5 vertices"):
        esd.register(blob, scan, correspondence=short)
    beyond = Correspondence(truth.target_index + 1, truth.distance, truth.confidence)
    with pytest.raises(InputError, match="The map names vertex"):
        esd.register(blob, scan, correspondence=beyond)
    nothing = Correspondence(np.full(len(blob.vertices), -1), truth.distance, truth.confidence)
    with pytest.raises(InputError, match="No vertex of the template has a match"):
        esd.register(blob, scan, correspondence=nothing)
