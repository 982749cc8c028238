"""The triangles that training sets and benchmarks are given."""

import sys
from pathlib import Path

import numpy as np
import pytest

from esd.datasets.collection import Shape
from esd.mesh.geometry import face_areas, surface_area
from esd.mesh.mesh import Mesh
from esd.mesh.shapes import subdivide
from esd.mesh.topology import edge_table

sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks"))
real_triangles = pytest.importorskip("real_triangles")  # with fast-simplification


@pytest.fixture
def person(blob):
    return subdivide(blob)


def longest_over_height(mesh):
    corners = mesh.vertices[mesh.faces]
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    return np.mean(sides.max(axis=1) ** 2 / (2 * face_areas(mesh)))


def test_triangles_are_longer_than_by_plain_decimation(person):
    axis = np.array([0.0, 0.0, 2.0])
    made = real_triangles.with_long_triangles(person, 800, stretch=4.0, axis=axis)
    assert len(made.vertices) == pytest.approx(800, abs=10)
    assert surface_area(made) == pytest.approx(surface_area(person), rel=0.02)
    plain = real_triangles.decimated(person, 800)
    assert longest_over_height(made) > 1.2 * longest_over_height(plain)


def test_defects_are_faces_twice_and_edges_of_three(person):
    made = real_triangles.with_defects(person, 0.01, np.random.default_rng(0))
    assert np.array_equal(made.faces[: len(person.faces)], person.faces)
    added = made.faces[len(person.faces) :]
    count = round(0.01 * len(person.faces))
    assert count < len(added) <= 2 * count
    as_sets = np.sort(person.faces, axis=1).tolist()
    twice = [sorted(face) in as_sets for face in added[:count].tolist()]
    assert all(twice)
    table = edge_table(made.faces, len(made.vertices))
    assert table.count.max() >= 3


@pytest.mark.parametrize("kind", [k for k in real_triangles.KINDS if k != "welded"])
def test_each_kind_says_where_the_old_vertices_are(kind):
    from esd.datasets.bodies import bodies

    mesh = bodies(remeshed=False)["s00_p00"].mesh()
    made, index = real_triangles.altered(mesh, kind, 3)
    again, _ = real_triangles.altered(mesh, kind, 3)
    assert np.array_equal(made.vertices, again.vertices)
    assert np.array_equal(made.faces, again.faces)
    assert index.shape == (len(mesh.vertices),)
    away = np.linalg.norm(made.vertices[index] - mesh.vertices, axis=1)
    assert np.quantile(away[index >= 0], 0.9) < 0.04  # metres: the spacing of the coarsest


def test_errors_are_those_of_the_unaltered_target(person):
    index = np.arange(len(person.vertices))
    shapes = [
        Shape(name=n, subject=n, template="t", mesh=lambda: person, correspondence=lambda: index)
        for n in "ab"
    ]
    kept = (person, index)
    exact = real_triangles.errors(*shapes, kept, kept, index)
    assert exact == pytest.approx(0)
    assert len(exact) == min(real_triangles.POINTS, len(index))
    turned = Mesh(person.vertices[::-1].copy(), len(index) - 1 - person.faces)
    there = (turned, index[::-1].copy())
    assert real_triangles.errors(*shapes, kept, there, index[::-1]) == pytest.approx(0)
    wrong = real_triangles.errors(*shapes, kept, kept, np.roll(index, 7))
    assert wrong.mean() > 1
    lost = real_triangles.errors(*shapes, kept, kept, np.full(len(index), -1))
    assert np.isnan(lost).all()


def test_pairs_are_of_different_subjects():
    index = np.arange(3)
    shapes = tuple(
        Shape(name=f"{s}{i}", subject=s, template="t", mesh=None, correspondence=lambda: index)
        for s in "abc"
        for i in range(3)
    )
    pairs = real_triangles.drawn_pairs(shapes, 10)
    assert len(pairs) == len({(a.name, b.name) for a, b in pairs}) == 10
    assert all(a.subject != b.subject for a, b in pairs)
