from dataclasses import replace

import numpy as np
import pytest

from esd.common import InputError
from esd.learning.model import load_model, raw_model
from esd.matching.correspondence import Correspondence, load_map, save_map
from esd.matching.match import match, with_similarity
from esd.mesh.mesh import Mesh
from esd.nearest import nearest


@pytest.mark.parametrize("width", [3, 100])  # by tree, by products
def test_nearest_is_the_nearest(width):
    generator = np.random.default_rng(0)
    source, target = (
        generator.standard_normal((70, width)) + 50,
        generator.standard_normal((90, width)) + 50,
    )
    every = np.linalg.norm(source[:, None] - target, axis=2)
    index, distance = nearest(source, target)
    np.testing.assert_array_equal(index, every.argmin(axis=1))
    np.testing.assert_allclose(distance, every.min(axis=1), rtol=1e-12)


def test_rows_that_are_not_finite_take_no_part():
    source = np.array([[0.0], [np.nan], [2.0]])
    target = np.array([[np.inf], [0.4], [1.9]])
    index, distance = nearest(source, target)
    np.testing.assert_array_equal(index, [1, -1, 2])
    assert np.isinf(distance[1])
    with pytest.raises(InputError, match="no vertex with a finite"):
        nearest(source, target[:1])
    with pytest.raises(InputError, match="equally long"):
        nearest(source, np.zeros((3, 2)))


def test_similarity_and_rejection():
    result = with_similarity(
        np.array([[0.0], [3.0]]), np.array([[1.0]]), np.array([0, 0]), margin=5.0
    )
    np.testing.assert_allclose(result.confidence, np.exp([-1 / 5, -4 / 5]))
    kept = result.rejecting(2.5)
    np.testing.assert_array_equal(kept.target_index, [0, -1])
    np.testing.assert_array_equal(kept.is_matched(), [True, False])
    assert kept.confidence[1] == 0


def test_without_margin_similarity_is_relative_to_chance():
    generator = np.random.default_rng(0)
    source, target = generator.standard_normal((300, 4)), generator.standard_normal((200, 4)) + 1
    mean = ((source[:, None] - target) ** 2).sum(axis=2).mean()
    result = with_similarity(source, target, nearest(source, target)[0], margin=None)
    np.testing.assert_allclose(result.confidence, np.exp(-(result.distance**2) / mean))


def test_a_shape_matches_its_moved_and_renumbered_self(blob):
    from esd.descriptors.recipe import Descriptor, Recipe
    from esd.learning.model import Model

    order = np.random.default_rng(0).permutation(len(blob.vertices))
    rotation = np.linalg.qr(np.random.default_rng(1).standard_normal((3, 3)))[0]
    moved = Mesh(2 * blob.vertices[order] @ rotation, np.argsort(order)[blob.faces])
    recipe = Recipe((Descriptor("hks", 30, log=True),), eigenpairs=100)
    model = Model("hks", recipe, np.zeros(30), np.ones(30))
    result = match(blob, moved, model=model)
    assert (order[result.target_index] == np.arange(len(order))).mean() > 0.99
    assert result.confidence.min() > 0.9
    assert result.judgement.verdict == "good"


@pytest.mark.parametrize("refine", [False, True])
def test_one_to_one_maps_take_no_vertex_twice(blob, refine):
    from esd.descriptors.recipe import Descriptor, Recipe
    from esd.learning.model import Model

    recipe = Recipe((Descriptor("hks", 30, log=True),), eigenpairs=100)
    model = Model("hks", recipe, np.zeros(30), np.ones(30))
    noisy = Mesh(
        blob.vertices * [1, 1.1, 1.2] + 0.01 * np.sin(9 * blob.vertices[:, ::-1]), blob.faces
    )
    usual, single = (
        match(blob, noisy, model=model, refine=refine, one_to_one=each, candidates=["embedding"])
        for each in (False, True)
    )
    taken = single.target_index[single.is_matched()]
    assert len(taken) == len(np.unique(taken)) > len(np.unique(usual.target_index))
    assert np.isinf(single.distance[~single.is_matched()]).all()


def test_too_small_meshes_are_refused_by_models():
    tetrahedron = Mesh(np.eye(4, 3), [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])
    with pytest.raises(InputError, match="300 eigenpairs were asked for; this mesh of 4"):
        match(tetrahedron, tetrahedron, model=raw_model("hks"))


@pytest.mark.parametrize("suffix", ["csv", "npy", "txt", "vts"])
def test_maps_come_back_as_they_were_saved(tmp_path, suffix):
    saved = Correspondence(
        np.array([2, -1, 0]), np.array([0.25, np.inf, 1.5]), np.array([0.5, 0.0, 0.125])
    )
    path = tmp_path / f"map.{suffix}"
    save_map(saved, path)
    back = load_map(path, source_count=3, target_count=3)
    np.testing.assert_array_equal(back.target_index, saved.target_index)
    if suffix == "csv":
        assert path.read_text().splitlines()[:2] == [
            "source,target,distance,confidence",
            "0,2,0.25,0.5",
        ]
        np.testing.assert_array_equal(back.distance, saved.distance)
        np.testing.assert_array_equal(back.confidence, saved.confidence)
    elif suffix != "npy":
        assert path.read_text() == "3\n0\n1\n"
    with pytest.raises(InputError, match="maps 3 vertices; the source mesh has 4"):
        load_map(path, source_count=4, target_count=3)
    with pytest.raises(InputError, match="names target vertex 2"):
        load_map(path, source_count=3, target_count=2)


def test_damaged_maps_are_refused(tmp_path):
    counts = {"source_count": 2, "target_count": 2}
    for name, content in [
        ("a.csv", b"from,to\n0,1\n"),
        ("b.csv", b"source,target\n0,x\n"),
        ("c.npy", b"garbage"),
        ("d.txt", b"one\n"),
    ]:
        (tmp_path / name).write_bytes(content)
        with pytest.raises(InputError, match=name):
            load_map(tmp_path / name, **counts)
    np.save(tmp_path / "e.npy", np.zeros((2, 2)))
    with pytest.raises(InputError, match=r"integers of shape \(n,\)"):
        load_map(tmp_path / "e.npy", **counts)
    np.save(tmp_path / "f.npy", np.array([{}, {}]), allow_pickle=True)
    with pytest.raises(InputError, match="holds no array"):
        load_map(tmp_path / "f.npy", **counts)
    with pytest.raises(InputError, match="ends in one of"):
        load_map(tmp_path / "g.xml", **counts)
    with pytest.raises(InputError, match="There is no file"):
        load_map(tmp_path / "g.csv", **counts)


def test_a_correspondence_shows_itself():
    match = Correspondence(
        np.array([2, 2, -1]), np.array([0.1, 0.2, np.inf]), np.array([0.5, 1, 0])
    )
    shown = match._repr_html_()
    assert "<td>2 (67%)</td>" in shown
    assert "different target vertices</th><td>1</td>" in shown
    assert shown.count("<rect") == 20
    unknown = np.full(3, np.nan)
    assert "confidence" not in Correspondence(match.target_index, unknown, unknown)._repr_html_()
    assert set(match.attributes()) == {"target", "distance", "confidence"}


@pytest.mark.parametrize("device", ["cpu:0", "cuda"])  # torch on the processor, and on a GPU
def test_torch_finds_the_map_that_numpy_finds(blob, device):
    torch = pytest.importorskip("torch", reason="other devices need the extra `train`")
    if device == "cuda" and not torch.cuda.is_available():
        pytest.skip("there is no GPU")
    here = load_model("default")
    there = replace(here, device=device)
    values = np.random.default_rng(0).normal(size=(50, here.recipe.width))
    np.testing.assert_allclose(there.embed(values), here.embed(values), rtol=1e-9, atol=1e-9)
    other = Mesh(blob.vertices * [1, 1.1, 1], blob.faces)
    a, b = (match(blob, other, model=model) for model in (here, there))
    np.testing.assert_array_equal(a.target_index, b.target_index)
    np.testing.assert_allclose(a.distance, b.distance, rtol=1e-5, atol=1e-6)


def test_unusable_devices_are_refused(monkeypatch):
    with pytest.raises(InputError, match="There is no device 'tpu'"):
        load_model("default", device="tpu")
    torch = pytest.importorskip("torch", reason="other devices need the extra `train`")
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    assert load_model("hks", device="auto").device == "cpu"
    with pytest.raises(InputError, match="torch finds no GPU here"):
        load_model("hks", device="cuda")
