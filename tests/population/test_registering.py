"""Registrations of a collection, with maps that are known: only what is around them is tested."""

import logging
from dataclasses import replace

import numpy as np
import pytest

from esd.common import InputError
from esd.datasets.collection import Collection
from esd.matching.correspondence import Correspondence
from esd.mesh.geometry import is_referenced
from esd.mesh.io.landmarks import Landmarks
from esd.mesh.io.ply import ply_bytes
from esd.mesh.mesh import Mesh
from esd.parallel import THIS_PROCESS
from esd.population import atlas as atlas_room
from esd.population import registering
from esd.population.atlas import atlas
from esd.population.registering import (
    Template,
    landmark_file,
    model_key,
    read_registered,
    registered_shapes,
    with_landmarks,
)


@pytest.fixture
def known_maps(monkeypatch, blob):
    """Features and maps are not computed: equal vertices correspond. Landmarks are recorded."""
    given = []

    def true(source, target, *, landmarks, **options):
        given.append(landmarks)
        count = len(blob.vertices)
        there = is_referenced(target)
        return Correspondence(
            np.where(there, np.arange(count), -1), np.zeros(count), there.astype(float)
        )

    monkeypatch.setattr(registering, "working_features", lambda repaired, **_: repaired.shape)
    monkeypatch.setattr(registering, "save_features", lambda features, folder: None)
    monkeypatch.setattr(registering, "load_features", lambda folder: None)
    monkeypatch.setattr(registering, "match_features", true)
    return given


def cut(mesh: Mesh, lacking: np.ndarray) -> Mesh:
    """The mesh without the faces at some vertices."""
    return Mesh(mesh.vertices, mesh.faces[~lacking[mesh.faces].any(axis=1)])


def test_missing_parts_stay_missing(known_maps, collection, blob, tmp_path):
    high = blob.vertices[:, 1] > np.quantile(blob.vertices[:, 1], 0.8)
    part = replace(collection.shapes[1], mesh=lambda: cut(collection.shapes[1].mesh(), high))
    shapes = (collection.shapes[0], part, *collection.shapes[2:])
    found = atlas(Collection("parts", shapes), template=blob, folder=tmp_path, workers=THIS_PROCESS)
    missing = np.isnan(found.vertices[1]).any(axis=1)
    assert missing[high].mean() > 0.8
    assert missing[~high].mean() < 0.1  # those at the rim
    assert (np.isnan(found.aligned[1]).any(axis=1) == missing).all()
    assert np.isfinite(found.vertices[[0, 2, 3]]).all()
    assert np.isfinite(found.mean).all()  # the others have it
    # what the model says of the part is between the others, not where the template was carried
    guess = found.model.reconstructed(found.scores[1])[missing]
    spread = np.ptp(found.aligned[[0, 2, 3]][:, missing], axis=0).max()
    assert np.abs(guess - found.mean[missing]).max() < spread
    # what only one shape has is in no statistics
    lacking = [replace(s, mesh=lambda s=s: cut(s.mesh(), high)) for s in collection.shapes[1:]]
    rest = Collection("parts", (collection.shapes[0], *lacking))
    found = atlas(rest, template=blob, workers=THIS_PROCESS)
    assert np.isnan(found.mean[high]).any(axis=1).mean() > 0.8
    assert np.isfinite(found.scores).all()
    assert np.isfinite(found.model.deviation()[~high]).mean() > 0.9  # but for the rim


def test_a_shape_that_fails_does_not_abort_the_others(known_maps, collection, blob):
    line = Mesh([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]], [[0, 1, 2]])

    def broken() -> Mesh:
        raise InputError("'c2.off' is no mesh.")

    shapes = (
        *collection.shapes,
        replace(collection.shapes[0], name="flat", mesh=lambda: line),
        replace(collection.shapes[0], name="broken", mesh=broken),
    )
    found = atlas(Collection("some", shapes), template=blob, workers=THIS_PROCESS)
    assert found.names == ("c0", "c1", "c2", "c3")
    assert set(found.left_out) == {"flat", "broken"}
    assert found.left_out["broken"] == "'c2.off' is no mesh."
    two = Collection("some", (*shapes[:2], *shapes[4:]))
    with pytest.raises(InputError, match=r"2 of the shapes can be used; .* 'c2.off' is no mesh"):
        atlas(two, template=blob, workers=THIS_PROCESS)


def test_a_shape_without_support_is_left_out(known_maps, collection, blob, tmp_path):
    first = atlas(collection, template=blob, folder=tmp_path, workers=THIS_PROCESS)
    path = tmp_path / "registered" / "c1.ply"
    none = np.zeros(len(blob.vertices), dtype=np.uint8)
    path.write_bytes(ply_bytes(Mesh(first.vertices[1], blob.faces), {"supported": none}))
    found = atlas(
        collection,
        template=blob,
        folder=tmp_path,
        keep_failed=True,
        keep_size=True,
        workers=THIS_PROCESS,
    )
    assert found.left_out == {"c1": "it has no surface where the template lies"}


def test_landmarks_lead_the_maps(known_maps, collection, blob, tmp_path, caplog):
    for shape in collection.shapes[:3]:
        text = "name,vertex\nb,7\na,3\nc,90\n"
        (tmp_path / f"{shape.name}.csv").write_text(text)
    with caplog.at_level(logging.WARNING):
        guided = with_landmarks(collection, tmp_path)
    assert f"Without landmarks in '{tmp_path}': c3." in caplog.text
    (tmp_path / "template.csv").write_text("name,vertex\na,30\nb,70\nc,9\nd,1\n")
    atlas(guided, template=blob, landmarks=tmp_path, workers=THIS_PROCESS)
    pairs = [None if each is None else each.tolist() for each in known_maps]
    assert pairs == [[[30, 3], [70, 7], [9, 90]]] * 3 + [None]


def test_a_template_without_landmarks_takes_those_of_the_shape_that_it_is_or_none(
    known_maps, collection, blob, tmp_path, caplog
):
    marks = Landmarks(("a", "b", "c"), np.array([3, -1, 90]))
    guided = replace(
        collection,
        shapes=tuple(replace(each, landmarks=lambda: marks) for each in collection.shapes),
    )
    moved = atlas_room._template_landmarks("c1", collection.shapes[1].mesh(), guided, None)
    assert moved.vertices.tolist() == [3, -1, 90]
    with caplog.at_level(logging.WARNING):
        atlas(guided, template=blob, workers=THIS_PROCESS)
    assert "The template 'template' has no landmarks" in caplog.text
    assert known_maps == [None] * 4


def test_a_change_of_anything_is_another_registration(known_maps, collection, blob, tmp_path):
    model = atlas_room.load_model("default")

    def is_new(shapes: Collection, template: Template, **changes) -> list[bool]:
        found = registered_shapes(
            shapes, template, tmp_path, model=replace(model, **changes), workers=THIS_PROCESS
        )
        return [each.is_new for each in found]

    three = Collection("three", collection.shapes[:3])
    assert is_new(three, Template(blob)) == [True, True, True]
    assert is_new(three, Template(blob), name="renamed") == [False, False, False]
    moved = replace(
        three.shapes[1], mesh=lambda: Mesh(2 * three.shapes[1].mesh().vertices, blob.faces)
    )
    assert is_new(replace(three, shapes=(three.shapes[0], moved)), Template(blob)) == [False, True]
    marks = Landmarks(("a", "b", "c"), np.array([3, 60, 90]))
    marked = replace(three.shapes[0], landmarks=lambda: marks)
    assert is_new(replace(three, shapes=(marked,)), Template(blob)) == [True]
    assert is_new(replace(three, shapes=(marked,)), Template(blob, marks)) == [True]
    assert is_new(replace(three, shapes=(marked,)), Template(blob, marks), limit=1.0) == [True]
    (tmp_path / "c0.json").write_text("{")
    assert is_new(replace(three, shapes=(marked,)), Template(blob, marks), limit=1.0) == [True]
    (tmp_path / "c0.ply").unlink()
    assert is_new(replace(three, shapes=(marked,)), Template(blob, marks), limit=1.0) == [True]


def test_what_is_no_registered_shape_is_refused(blob, tmp_path):
    with pytest.raises(InputError, match=r"c0\.ply' cannot be read as a registered shape"):
        read_registered(tmp_path, "c0", blob.faces)


def test_files_of_landmarks_are_named_as_the_shapes(tmp_path):
    (tmp_path / "a.mrk.json").write_text("{}")
    assert landmark_file(tmp_path, "a") == tmp_path / "a.mrk.json"
    assert landmark_file(tmp_path, "b") is None


def test_equal_models_have_equal_keys():
    model = atlas_room.load_model("default")
    assert model_key(model) == model_key(replace(model, name="other", card={}, device="cuda"))
    assert model_key(model) != model_key(replace(model, layers=model.layers[:-1]))
