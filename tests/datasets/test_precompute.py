from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from bent import RECIPE, bent, bent_shapes, points
from esd.common import InputError
from esd.datasets.collection import Collection
from esd.datasets.open import open_collection
from esd.datasets.precompute import precompute
from esd.datasets.store import open_store
from esd.descriptors.recipe import descriptors
from esd.mesh.shapes import torus
from esd.parallel import Workers


@pytest.fixture
def collection() -> Collection:
    """Shapes in an order that is not that of their names."""
    return bent_shapes((2, 0, 1))


def test_a_store_holds_what_is_computed_directly(collection, tmp_path):
    path = tmp_path / "s.h5"
    done = precompute(collection, RECIPE, path, workers=Workers(1))
    assert (done.computed, done.unchanged, done.failures) == (3, 0, ())
    store = open_store(path)
    assert store.names == ("c0", "c1", "c2")
    assert (store.recipe, store.testing_subjects) == (RECIPE, ("s2",))
    assert isinstance(store.descriptors, np.memmap)
    everything = []
    for i in range(3):
        values, index = store.read(i)
        exact = descriptors(RECIPE, bent(i))
        np.testing.assert_allclose(values, exact, rtol=2**-24)  # half a unit in the last place
        np.testing.assert_array_equal(index, points(i))
        everything.append(values)
    mean, variance = store.moments([0, 1, 2])
    together = np.concatenate(everything).astype(np.float64)
    np.testing.assert_allclose(mean, together.mean(axis=0), rtol=1e-12)  # float64 sums
    np.testing.assert_allclose(variance, together.var(axis=0), rtol=1e-9)
    assert [file.name for file in tmp_path.iterdir()] == ["s.h5"]


def test_the_store_is_the_same_for_any_number_of_workers(collection, tmp_path, monkeypatch):
    monkeypatch.setenv("ESD_CACHE", "off")
    for workers in (1, 2):
        precompute(collection, RECIPE, tmp_path / f"{workers}.h5", workers=Workers(workers))
    assert (tmp_path / "1.h5").read_bytes() == (tmp_path / "2.h5").read_bytes()


def test_only_what_changed_is_computed_again(collection, tmp_path):
    path = tmp_path / "s.h5"
    precompute(replace(collection, shapes=collection.shapes[:2]), RECIPE, path, workers=Workers(1))
    first = path.read_bytes()
    done = precompute(
        replace(collection, shapes=collection.shapes[:2]), RECIPE, path, workers=Workers(1)
    )
    assert (done.computed, done.unchanged) == (0, 2)
    assert path.read_bytes() == first
    changed = replace(collection.shapes[0], mesh=partial(bent, 5))
    done = precompute(
        replace(collection, shapes=(changed, collection.shapes[2])),
        RECIPE,
        path,
        workers=Workers(1),
    )
    assert (done.computed, done.unchanged) == (2, 0)
    store = open_store(path)
    assert store.names == ("c0", "c1", "c2")  # c0 stayed
    assert len(store.read(2)[0]) == len(bent(5).vertices)
    np.testing.assert_array_equal(store.read(0)[1], points(0))


def test_an_interrupted_run_goes_on(collection, tmp_path):
    path = tmp_path / "s.h5"
    calls = []

    def stop():
        calls.append(1)
        if len(calls) == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        precompute(collection, RECIPE, path, workers=Workers(1), on_shape=stop)
    assert not path.exists()
    done = precompute(collection, RECIPE, path, workers=Workers(1))
    assert (done.computed, done.unchanged) == (1, 2)
    precompute(collection, RECIPE, tmp_path / "straight.h5", workers=Workers(1))
    assert path.read_bytes() == (tmp_path / "straight.h5").read_bytes()


def test_shapes_that_fail_are_reported_and_the_others_are_stored(collection, tmp_path):
    path = tmp_path / "s.h5"
    small = replace(
        collection.shapes[0], mesh=partial(torus, 4, 3), correspondence=partial(np.arange, 3)
    )
    beyond = replace(collection.shapes[1], correspondence=partial(np.arange, 10**4))
    broken = replace(collection, shapes=(small, beyond, collection.shapes[2]))
    done = precompute(broken, RECIPE, path, workers=Workers(1))
    assert [name for name, _ in done.failures] == ["c0", "c2"]
    assert "names vertex 9999" in done.failures[0][1]
    assert "15 eigenpairs" in done.failures[1][1]
    assert open_store(path).names == ("c1",)
    assert precompute(collection, RECIPE, path, workers=Workers(1)).computed == 2
    precompute(broken, RECIPE, path, workers=Workers(1))
    assert open_store(path).names == ("c1",)  # what was of another content is gone
    none = precompute(
        replace(collection, shapes=(small,)), RECIPE, tmp_path / "n.h5", workers=Workers(1)
    )
    assert none.failures
    assert not (tmp_path / "n.h5").exists()


def test_copies_with_other_triangles_are_described_too(collection, tmp_path):
    path = tmp_path / "s.h5"
    one = replace(collection, shapes=collection.shapes[:1])
    wide = replace(RECIPE, eigenpairs=10)
    done = precompute(one, wide, path, remeshings=1, workers=Workers(1))
    assert done.computed == 2
    assert open_store(path).names == ("c2", "c2~0")
    opened = open_collection(path)
    assert [shape.name for shape in opened.shapes] == ["c2"]
    np.testing.assert_array_equal(opened["c2"].correspondence(), points(2))
    with pytest.raises(InputError, match="holds no meshes"):
        opened["c2"].mesh()
