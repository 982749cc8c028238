import json
from dataclasses import replace

import numpy as np
import pytest

from esd.common import InputError
from esd.datasets.collection import Collection
from esd.mesh.io.meshes import read_mesh
from esd.mesh.mesh import Mesh
from esd.mesh.shapes import icosphere
from esd.parallel import THIS_PROCESS
from esd.population.atlas import Atlas, atlas, is_atlas_folder, reason_to_leave_out
from esd.population.registering import RegisteredShape


def meshes(count: int = 6) -> list[Mesh]:
    """Ellipsoids of one connectivity, longer and longer along x."""
    sphere = icosphere(2)
    return [Mesh(sphere.vertices * [1 + 0.1 * i, 1, 1], sphere.faces) for i in range(count)]


def test_one_way_of_variation_is_one_mode(ellipsoids):
    # but for rotation and scaling, which are no linear motion
    assert ellipsoids.model.explained()[0] > 0.99
    order = ellipsoids.scores[:, 0] * np.sign(ellipsoids.scores[-1, 0])
    assert (np.diff(order) > 0).all()
    assert ellipsoids.names == tuple(f"shape_{i}" for i in range(6))
    assert ellipsoids.vertices.shape == ellipsoids.aligned.shape == (6, 162, 3)
    assert ellipsoids.model.reconstructed(ellipsoids.scores) == pytest.approx(ellipsoids.aligned)
    assert (ellipsoids.mean, ellipsoids.modes, ellipsoids.variances) == (
        ellipsoids.model.mean,
        ellipsoids.model.modes,
        ellipsoids.model.variances,
    )
    assert repr(ellipsoids).startswith("<Atlas of 6 shapes: ")


def test_sizes_count_only_if_they_are_kept():
    scaled = [Mesh((1 + 0.2 * i) * each.vertices, each.faces) for i, each in enumerate(meshes())]
    removed, plain = atlas(scaled, registered=True), atlas(meshes(), registered=True)
    size = [np.exp(np.log(found.sizes).mean()) for found in (removed, plain)]
    assert removed.variances[0] / size[0] ** 2 == pytest.approx(plain.variances[0] / size[1] ** 2)
    kept = atlas(scaled, registered=True, keep_size=True)
    assert kept.model.total_variance > 2 * removed.model.total_variance


def test_another_unit_of_length_is_no_size():
    mixed = meshes()
    mixed[2] = Mesh(1000 * mixed[2].vertices, mixed[2].faces)
    found = atlas(mixed, registered=True, keep_size=True)
    assert found.left_out["shape_2"].startswith(
        "it is 889 times as large as usual"
    )  # 1.2 over the median, 1.35
    assert len(found.names) == 5
    assert atlas(mixed, registered=True).left_out == {}  # where sizes are removed, units are, too


def test_shapes_of_another_connectivity_are_left_out():
    mixed = [*meshes(3), icosphere(1)]
    found = atlas(mixed, registered=True)
    assert found.left_out == {"shape_3": "its connectivity is not that of 'shape_0'"}
    with pytest.raises(
        InputError, match=r"2 of the shapes can be used; an atlas needs 3 or more\. 'shape_2'"
    ):
        atlas([*meshes(2), icosphere(1)], registered=True)


@pytest.mark.parametrize("count", [0, 1, 2])
def test_fewer_than_three_shapes_are_no_population(count):
    with pytest.raises(InputError, match=f"An atlas needs 3 shapes or more; 'shapes' has {count}"):
        atlas(meshes(count), registered=True)


def test_what_makes_no_sense_is_refused(tmp_path, collection):
    with pytest.raises(InputError, match="`modes` must be at least 1; got 0"):
        atlas(meshes(), registered=True, modes=0)
    with pytest.raises(InputError, match="holds descriptors, no meshes"):
        atlas(replace(collection, store=tmp_path / "a.h5"))
    flat = Mesh(np.zeros((3, 3)), [[0, 1, 2]])
    with pytest.raises(InputError, match="The faces of the template have no area"):
        atlas(meshes(), template=flat)
    with pytest.raises(InputError, match="There is no folder of landmarks"):
        atlas(meshes(), landmarks=tmp_path / "none")
    with pytest.raises(InputError, match="holds landmarks of no shape of 'shapes'; expected files"):
        atlas(meshes(), landmarks=tmp_path)


def test_shapes_that_cannot_be_described_are_no_template():
    line = Mesh([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]], [[0, 1, 2]])
    with pytest.raises(InputError, match="2 of the shapes can be used"):
        atlas([*meshes(2), line, line], workers=THIS_PROCESS)


def test_what_failed_is_left_out():
    good = RegisteredShape("a", "a", verdict="good", distance=0.001, covered=0.99)
    assert reason_to_leave_out(good) == ""
    assert reason_to_leave_out(replace(good, failure="broken")) == "broken"
    assert reason_to_leave_out(replace(good, verdict="failed")) == "the map is failed"
    assert reason_to_leave_out(replace(good, verdict="mirrored")) == "the map is mirrored"
    assert "2.0% of the extent off" in reason_to_leave_out(replace(good, distance=0.02))
    assert reason_to_leave_out(replace(good, distance=float("nan")))
    assert reason_to_leave_out(replace(good, covered=0.7)) == (
        "the registered template covers 70% of the shape"
    )
    assert reason_to_leave_out(replace(good, covered=float("nan")))


def test_an_atlas_of_unregistered_shapes_resumes(collection, tmp_path, monkeypatch):
    from esd.population import registering

    folder = tmp_path / "atlas"
    steps = []
    shapes = Collection("copies", collection.shapes[:3])

    def made(**options) -> Atlas:
        return atlas(
            shapes,
            folder=folder,
            workers=THIS_PROCESS,
            keep_failed=True,
            on_shape=lambda: steps.append(1),
            **options,
        )

    first = made()
    assert len(steps) == 6
    assert [each.is_new for each in first.shapes] == [True] * 3
    # the registered template is where the shape is, though its own triangles are unknown to it
    place = folder / "registered"
    for shape in shapes.shapes:
        found = read_mesh(place / f"{shape.name}.ply")
        assert np.array_equal(found.faces, first.faces)
        gap = np.linalg.norm(found.vertices - shape.mesh().vertices, axis=1)
        assert np.median(gap) < 0.1  # of shapes about 3 wide

    # the second is gone, the third has other content: both are computed, the first is not
    (place / "c1.json").unlink()
    known = json.loads((place / "c2.json").read_text())
    (place / "c2.json").write_text(json.dumps({**known, "fingerprint": "another"}))
    computed = []
    register = registering.register
    monkeypatch.setattr(
        registering, "register", lambda *a, **k: computed.append(1) or register(*a, **k)
    )
    again = made()
    assert [each.is_new for each in again.shapes] == [False, True, True]
    assert len(computed) == 2
    assert again.template == first.template
    np.testing.assert_array_equal(again.mean, first.mean)

    with pytest.raises(InputError, match="holds an atlas with another template; choose another"):
        made(template=shapes.shapes[0].mesh())
    (place / "c0.ply").write_bytes(b"ply")
    with pytest.raises(InputError, match="cannot be read as a registered shape"):
        made()
    (folder / "atlas.json").write_text("[]")
    with pytest.raises(InputError, match="cannot be read: it holds no object"):
        made()


def test_other_folders_are_not_written_to(tmp_path):
    (tmp_path / "photo.jpg").write_text("")
    assert not is_atlas_folder(tmp_path)
    with pytest.raises(InputError, match="holds other files and no atlas"):
        atlas(meshes(), registered=True, folder=tmp_path)
    file = tmp_path / "photo.jpg"
    with pytest.raises(InputError, match="cannot be written to"):
        atlas(meshes(), registered=True, folder=file / "a")
