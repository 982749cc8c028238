import sys

import numpy as np
import pytest

from damaged import COUNT, SPHERE, found, joined
from esd.common import InputError
from esd.mesh.mesh import Mesh
from esd.mesh.repair.repair import repair
from esd.mesh.shapes import icosphere


def test_a_moebius_strip_is_found():
    count = 200
    angle = 2 * np.pi * np.arange(count) / count
    radius = 1 + 0.3 * np.outer([-1, 1], np.cos(angle / 2))
    height = 0.3 * np.outer([-1, 1], np.sin(angle / 2))
    vertices = np.stack([radius * np.cos(angle), radius * np.sin(angle), height], axis=2)
    low = np.arange(count)
    after = np.append(low[1:], count)  # the strip closes with its edges exchanged
    above = np.append(low[1:] + count, 0)
    faces = np.concatenate(
        [np.stack([low, after, low + count], 1), np.stack([after, above, low + count], 1)]
    )
    kinds = found((vertices.reshape(-1, 3), faces))
    assert kinds["one_sided_pieces"] == 1
    assert kinds["holes"] == 1  # its one rim


def test_slivers_folds_and_few_vertices_are_found():
    flat = Mesh(SPHERE.vertices * [1, 1, 1e-4], SPHERE.faces)
    assert {"slivers", "folded_edges"} & set(found(flat))
    rough = np.random.default_rng(0).standard_normal((COUNT, 1)) * 0.3
    assert "folded_edges" in found(Mesh(SPHERE.vertices * (1 + rough), SPHERE.faces))
    assert found(icosphere(1)) == {"few_vertices": 1}
    assert found((np.zeros((3, 3)), np.array([[0, 1, 2]])))["flat_meshes"] == 1
    with pytest.raises(InputError, match="Nothing of the mesh can be used"):
        repair((np.zeros((3, 3)), np.array([[0, 1, 2]])))


def test_vertices_that_are_no_number_are_named_once():
    vertices = SPHERE.vertices.copy()
    vertices[3] = np.nan
    kinds = found((vertices, SPHERE.faces))
    assert kinds["non_finite_vertices"] == 1
    assert "unreferenced_vertices" not in kinds
    more = np.concatenate([vertices, [[9.0, 9, 9], [np.nan, 0, 0]]])
    kinds = found((more, SPHERE.faces))
    assert (kinds["non_finite_vertices"], kinds["unreferenced_vertices"]) == (2, 1)


def test_faces_that_cut_through_each_other_are_found_where_libigl_is_there(monkeypatch):
    crossing = joined(SPHERE, Mesh(SPHERE.vertices + np.array([1, 0.1, 0.2]), SPHERE.faces))
    monkeypatch.setitem(sys.modules, "igl.copyleft", None)
    assert "self_intersections" not in found(crossing)
    monkeypatch.undo()
    pytest.importorskip("igl")
    assert found(crossing)["self_intersections"] > 50
    assert "self_intersections" not in found(SPHERE)
    assert "self_intersections" not in found(crossing, thorough=False)
