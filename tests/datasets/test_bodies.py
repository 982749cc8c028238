import numpy as np
import pytest

from esd.datasets.bodies import (
    PARTS,
    TESTING_SUBJECTS,
    TRAINING_SUBJECTS,
    _pack,
    bodies,
    mirrored_points,
    part_labels,
)
from esd.mesh.geometry import (
    components,
    edges,
    face_areas,
    is_consistently_oriented,
)
from esd.mesh.mesh import Mesh
from esd.mesh.topology import boundary_edges
from measures import signed_volume


@pytest.fixture(scope="module")
def registered():
    return bodies(remeshed=False)


@pytest.fixture(scope="module")
def remeshed():
    return bodies(vertex_count=2000)


def test_there_are_ten_poses_of_each_subject_and_no_subject_on_both_sides(registered):
    assert set(registered.subjects) == {*TRAINING_SUBJECTS, *TESTING_SUBJECTS}
    assert not set(TRAINING_SUBJECTS) & set(TESTING_SUBJECTS)
    assert len(TRAINING_SUBJECTS) == 10
    assert len(TESTING_SUBJECTS) == 4
    assert len(registered.shapes) == len({s.name for s in registered.shapes}) == 140
    assert registered["s03_p07"].subject == "s03"


def test_bodies_are_closed_surfaces_of_people_standing_on_the_floor(registered):
    for shape in registered.shapes:
        mesh = shape.mesh()
        assert np.ptp(mesh.vertices[:, 2]) > 0.9, shape.name
        assert abs(mesh.vertices[:, 2].min()) < 1e-4, shape.name
        assert 0.03 < signed_volume(mesh) < 0.15, shape.name  # cubic metres
        assert face_areas(mesh).min() > 1e-7, shape.name
    assert len(boundary_edges(mesh)) == 0
    assert is_consistently_oriented(mesh)
    assert components(mesh).max() == 0
    assert len(mesh.vertices) - len(edges(mesh)) + len(mesh.faces) == 2


def test_people_are_alike_and_unlike():
    pack = _pack()
    pairs = edges(Mesh(pack.rest[0], pack.faces))
    length = np.linalg.norm(np.diff(pack.rest[:, pairs], axis=2)[:, :, 0], axis=2)
    distortion = np.abs(length[:, None] / length[None] - 1).mean(axis=2)
    apart = distortion[~np.eye(len(length), dtype=bool)]
    assert apart.min() < 0.05
    assert apart.max() > 0.3


def test_every_subject_takes_poses_of_its_own():
    pack = _pack()
    turns = pack.motions[..., :3].reshape(14, 10, -1)
    for pose in range(10):
        apart = np.abs(turns[:, None, pose] - turns[None, :, pose]).max(axis=2)
        assert apart[~np.eye(14, dtype=bool)].min() > 0.05


def test_the_mirror_is_an_exact_symmetry_of_the_template():
    pack, mirror = _pack(), mirrored_points()
    assert (mirror[mirror] == np.arange(len(mirror))).all()
    # rest shapes are stored in whole steps, which mirror exactly
    assert np.abs(pack.rest[:, mirror] * [-1, 1, 1] - pack.rest).max() < 1e-12
    swapped = np.sort(mirror[pack.faces], axis=1)
    assert {*map(tuple, swapped.tolist())} == {*map(tuple, np.sort(pack.faces, axis=1).tolist())}


def test_parts_swap_sides_under_the_mirror():
    labels = part_labels()
    assert set(labels) == set(range(len(PARTS)))
    swap = {"left": "right", "right": "left"}
    for part, name in enumerate(PARTS):
        side, _, rest = name.partition(" ")
        other = PARTS.index(f"{swap[side]} {rest}") if side in swap else part
        found = labels[mirrored_points()[labels == part]]
        # the two sides of the model's skinning weights differ by rounding
        assert (found == other).mean() > 0.99, name


def test_parts_are_where_they_belong():
    rest, labels = _pack().rest[0], part_labels()
    middle = {name: rest[labels == part].mean(axis=0) for part, name in enumerate(PARTS)}
    assert middle["left hand"][0] > middle["left arm"][0] > middle["torso"][0]
    assert middle["left foot"][0] > 0 > middle["right foot"][0]
    assert middle["head"][2] > middle["torso"][2] > middle["left leg"][2] > middle["left foot"][2]


def test_remeshed_bodies_are_closed_and_of_different_connectivity(remeshed):
    seen = set()
    for name in ("s00_p00", "s00_p01", "s09_p03", "s12_p05"):
        mesh = remeshed[name].mesh()
        assert len(boundary_edges(mesh)) == 0
        assert is_consistently_oriented(mesh)
        assert components(mesh).max() == 0
        assert len(mesh.vertices) - len(edges(mesh)) + len(mesh.faces) == 2
        assert 2000 <= len(mesh.vertices) < 2200
        assert signed_volume(mesh) > 0
        assert face_areas(mesh).min() > 0
        seen.add(mesh.faces[:50].tobytes())
    assert len(seen) == 4


def test_remeshed_correspondence_is_near_the_surface_point(registered, remeshed):
    name = "s05_p02"
    old, new = registered[name].mesh(), remeshed[name].mesh()
    gap = np.linalg.norm(new.vertices[remeshed[name].correspondence()] - old.vertices, axis=1)
    spacing = np.sqrt(2 / np.sqrt(3) * face_areas(old).sum() / len(new.vertices))
    # the mean distance to the nearest point of a hexagonal lattice is 0.38 of its spacing
    assert gap.mean() < 0.5 * spacing
    assert gap.max() < 3 * spacing


def test_remeshed_symmetry_is_the_correspondence_of_the_mirrored_points(remeshed):
    shape = remeshed["s02_p00"]
    assert shape.symmetric is not None
    assert (shape.symmetric() == shape.correspondence()[mirrored_points()]).all()


def test_remeshing_is_the_same_in_each_call_and_follows_the_seed():
    first, again = (bodies(vertex_count=500)["s01_p01"].mesh() for _ in range(2))
    other = bodies(vertex_count=500, seed=1)["s01_p01"].mesh()
    assert (first.vertices == again.vertices).all()
    assert first.vertices.shape != other.vertices.shape or (
        (first.vertices != other.vertices).any()
    )
