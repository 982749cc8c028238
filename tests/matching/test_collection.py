import csv
import json
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from esd.common import InputError
from esd.learning.model import Model, load_model, save_model
from esd.matching import batch
from esd.matching.batch import PairOfFiles, match_files, read_pairs_of_files
from esd.matching.choice import chained
from esd.matching.collection import composed, cycle_miss, trusted_chains
from esd.matching.match import match_features, prepared, working_features
from esd.mesh.io.meshes import write_mesh
from esd.parallel import THIS_PROCESS
from knobbed import RECIPE, knobbed, truth


def test_a_chain_of_good_maps_is_preferred_to_a_bad_map_and_a_sure_map_to_any_chain():
    accuracy = {(0, 1): 0.95, (1, 2): 0.95, (0, 2): 0.5, (2, 0): 1.0, (2, 1): 1.0, (1, 0): 1.0}
    chains = trusted_chains(accuracy, 3)
    assert chains[0, 2] == (0, 1, 2)
    assert chains[2, 0] == (2, 0)  # as sure as by way of 1, and shorter
    assert set(chains) == {(i, j) for i in range(3) for j in range(3) if i != j}


def test_shapes_that_no_chain_connects_have_none():
    assert trusted_chains({(0, 1): 0.9}, 3) == {(0, 1): (0, 1)}
    with pytest.raises(InputError, match=r"Accuracies are from 0 to 1; got 1\.2"):
        trusted_chains({(0, 1): 1.2}, 2)


@settings(max_examples=25, deadline=None)
@given(st.integers(3, 6), st.integers(0, 2**16))
def test_no_other_chain_is_expected_to_be_more_accurate(count, seed):
    generator = np.random.default_rng(seed)
    pairs = [(i, j) for i in range(count) for j in range(count) if i != j]
    accuracy = {pair: float(generator.uniform(0.01, 1)) for pair in pairs}

    def product(chain):
        return np.prod([accuracy[a, b] for a, b in pairwise(chain)])

    chains = trusted_chains(accuracy, count)
    for (i, j), chain in chains.items():
        # if every chain of one more stop is worse, no chain is better
        others = [product((i, j))] + [
            product((*chains[i, k], j)) for k in range(count) if k not in (i, j)
        ]
        assert product(chain) >= max(others) * (1 - 1e-4)


def test_maps_are_composed_and_missing_matches_stay_missing():
    np.testing.assert_array_equal(
        composed([np.array([2, 0, -1]), np.array([5, -1, 7])]), [7, 5, -1]
    )


def test_cycles_of_true_maps_close_and_a_shifted_map_misses():
    shapes = {i: knobbed(i).vertices for i in range(3)}
    maps = {(i, j): truth(i, j) for i in range(3) for j in range(3) if i != j}
    assert cycle_miss(maps, shapes) == 0
    assert cycle_miss({(0, 1): maps[0, 1]}, shapes) is None
    wrong = np.roll(maps[0, 2], 1)
    away = np.linalg.norm(shapes[2][wrong] - shapes[2][maps[0, 2]], axis=1).mean()
    # of the six triples of shapes, half have the map from 0 to 2 in them
    assert cycle_miss({**maps, (0, 2): wrong}, shapes) == pytest.approx(away / 2, rel=0.3)


@pytest.fixture(scope="module")
def model() -> Model:
    return Model("raw", RECIPE, np.zeros(RECIPE.width), np.ones(RECIPE.width))


def test_a_map_by_way_of_others_is_refined(model):
    features = [
        working_features(prepared(knobbed(seed)), model=model, full=True) for seed in (1, 2)
    ]
    by_way = truth(1, 2)
    by_way[::2] = -1
    found = match_features(*features, model=model, by_way=by_way)
    there = knobbed(2).vertices
    away = np.linalg.norm(there[found.target_index] - there[truth(1, 2)], axis=1).mean()
    assert away < 0.4  # the shapes are about six wide
    assert list(found.judgement.costs) == ["chain"]
    with pytest.raises(InputError, match="A map to be refined has no match"):
        chained(*features, np.full(642, -1))


@pytest.fixture
def files(tmp_path):
    paths = [tmp_path / f"s{seed}.ply" for seed in range(3)]
    for seed, path in enumerate(paths):
        write_mesh(knobbed(seed), path)
    return paths


def test_a_bad_map_is_replaced_by_one_through_another_shape(files, model, tmp_path, monkeypatch):
    def with_a_bad_map(source, target, *, by_way=None, **options):
        """The direct maps are known; that from the first to the last shape is bad."""
        found = match_features(source, target, by_way=by_way, **options)
        if by_way is not None:
            return found
        ends = [
            next(seed for seed in range(3) if np.allclose(knobbed(seed).vertices, shape.vertices))
            for shape in (source.shape, target.shape)
        ]
        index = truth(*ends)
        accuracy, costs = 0.95, {"embedding": -100.0}
        if ends == [0, 2]:
            index = np.random.default_rng(0).permutation(index)
            accuracy, costs = 0.3, {"embedding": 100.0}
        judged = replace(found.judgement, expected_accuracy=accuracy, costs=costs)
        return replace(found, target_index=index, judgement=judged)

    monkeypatch.setattr(batch, "match_features", with_a_bad_map)
    pairs = tuple(
        PairOfFiles(a, b, tmp_path / f"{a.stem}-{b.stem}.csv")
        for a in files
        for b in files
        if a != b
    )
    reports = []
    done = match_files(
        pairs, model=model, full=True, workers=THIS_PROCESS, on_collection=reports.append
    )
    chains = {(each.pair.source.stem, each.pair.target.stem): each.chain for each in done}
    assert chains.pop(("s0", "s2")) == ("s1",)
    assert set(chains.values()) == {()}
    (report,) = reports
    assert report.improved == 1
    assert report.miss_after < 0.5 * report.miss_before
    assert (
        "1 of 1 maps by way of other shapes were better; maps a to c differ" in report.in_a_line()
    )
    with (tmp_path / "s0-s2.csv").open(newline="") as file:
        index = np.array([int(row["target"]) for row in csv.DictReader(file)])
    there = knobbed(2).vertices
    assert np.linalg.norm(there[index] - there[truth(0, 2)], axis=1).mean() < 0.5


def test_the_command_reports_on_the_collection(run, files, model, tmp_path):
    save_model(model, tmp_path / "raw")
    rows = [f"{a.name},{b.name}" for a in files for b in files if a != b]
    (tmp_path / "pairs.csv").write_text("source,target\n" + "\n".join(rows) + "\n")
    options = ("--model", tmp_path / "raw", "--full", "--candidates", "embedding", "--workers", 1)
    where = ("-o", tmp_path / "maps")
    done = run("batch", tmp_path / "pairs.csv", *where, *options, "--collection", "--json")
    found = json.loads(done.stdout)
    assert found["collection"]["tried"] >= found["collection"]["improved"] >= 0
    assert found["collection"]["miss_after"] <= found["collection"]["miss_before"] + 0.01
    assert all(each["cost"] is not None for each in found["maps"])


def test_maps_of_points_are_counted_as_well(tmp_path, blob):
    for i, name in enumerate("abc"):
        np.savetxt(tmp_path / f"{name}.xyz", blob.vertices * (1 + 0.02 * i))
    names = [f"{a}.xyz,{b}.xyz" for a in "abc" for b in "abc" if a != b]
    (tmp_path / "pairs.csv").write_text("\n".join(["source,target", *names, ""]))
    reports = []
    pairs = read_pairs_of_files(tmp_path / "pairs.csv", folder=tmp_path)
    model = load_model("hks")
    done = list(match_files(pairs, model=model, workers=THIS_PROCESS, on_collection=reports.append))
    assert [each.failure for each in done] == [None] * 6
    assert all(each.verdict == "good" for each in done)
    # copies of one cloud: all maps agree
    assert reports[0].miss_before == pytest.approx(0, abs=1e-6)
