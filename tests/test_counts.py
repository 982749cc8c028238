"""Counts in place of times: what would show that some way takes time or memory by the square."""

import pickle
import tracemalloc

import numpy as np

from esd import nearest as neighbours
from esd.learning.model import load_model
from esd.matching import batch, candidates, extrinsic, local_refine, match
from esd.mesh.shapes import icosphere, subdivide
from esd.nearest import nearest
from esd.parallel import Outcome
from esd.spectral import eigensolver, spectrum


def test_a_spectrum_takes_as_many_factorisations_of_any_mesh(blob, monkeypatch):
    """Of some hundred vertices and of four times as many: one that certifies, some that seek."""
    counts = []
    original = eigensolver.factorise

    def counted(*arguments, **keywords):
        counts[-1] += 1
        return original(*arguments, **keywords)

    monkeypatch.setattr(eigensolver, "factorise", counted)
    for mesh in (blob, subdivide(blob)):
        counts.append(0)
        spectrum.spectrum(mesh, 40)
    assert 1 <= counts[0] <= 6
    assert counts[1] <= 6


def test_nearest_rows_take_memory_in_proportion_to_the_rows():
    peaks = []
    for count in (4000, 16_000):
        rows = np.random.default_rng(0).standard_normal((2, count, 30)).astype(np.float32)
        tracemalloc.start()
        nearest(*rows)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] < 6 * peaks[0]  # 16 times where there is a matrix of all pairs


def test_what_goes_to_a_worker_does_not_grow_with_the_batch(tmp_path, monkeypatch):
    taken = []

    def recorded(function, jobs, **_):
        for job in jobs:
            taken.append(len(pickle.dumps((function, job))))
            yield Outcome(job, failure=None if isinstance(job, tuple) else "not computed here")

    monkeypatch.setattr(batch, "outcomes", recorded)
    largest = []
    for count in (4, 400):
        taken.clear()
        files = [tmp_path / f"shape{i:04d}.off" for i in range(count)]
        pairs = [
            batch.PairOfFiles(a, b, tmp_path / f"{a.stem}.csv")
            for a, b in zip(files, files[1:] + files[:1], strict=True)
        ]
        done = list(batch.match_files(pairs, model=load_model("hks")))
        assert len(taken) == 2 * count == 2 * len(done)
        largest.append(max(taken))
    assert largest[1] < 1.1 * largest[0]


def test_dense_meshes_are_matched_by_coarse_copies(monkeypatch):
    """Whatever a mesh has, its spectrum is that of a copy of about as many vertices."""
    described = []

    def recorded(repaired, *, coarse, **_):
        described.append(coarse)

    monkeypatch.setattr(match, "shape_features", recorded)
    monkeypatch.setattr(match, "DENSE", 100)
    for mesh in (icosphere(1), icosphere(2), icosphere(3)):
        match.working_features(match.prepared(mesh), model=load_model("hks"), refine=True)
    assert described == [None, match.COARSE, match.COARSE]


def test_a_match_takes_products_of_rows_in_proportion_to_the_vertices(blob, monkeypatch):
    """From repaired shapes to the verdict, with candidates and refinement, without copies."""
    products = []

    def by_products(source, target, device):
        products[-1] += len(source) * len(target)
        return original[0](source, target, device)

    def within(source, target, *arguments):
        index, taken = original[1](source, target, *arguments)
        products[-1] += taken
        return index, taken

    original = neighbours._by_products, local_refine.nearest_within
    monkeypatch.setattr(neighbours, "_by_products", by_products)
    monkeypatch.setattr(local_refine, "nearest_within", within)
    # so few samples that their own products, which are bounded, are few
    for module, name, count in (
        (local_refine, "_SAMPLES", 60),
        (extrinsic, "_SAMPLES", 60),
        (candidates, "_TRIANGLES", 20),
    ):
        monkeypatch.setattr(module, name, count)
    for mesh in (blob, subdivide(blob)):
        products.append(0)
        model = load_model("wks")
        found = match.match(
            mesh, mesh, model=model, refine=True, full=True, candidates=["embedding"]
        )
        assert found.judgement is not None
    assert 0 < products[1] < 8 * products[0]  # 4 times the vertices; 16 times by the square
