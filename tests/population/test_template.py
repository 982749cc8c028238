import numpy as np
import pytest

from esd.datasets.collection import Shape
from esd.mesh.mesh import Mesh
from esd.mesh.shapes import icosphere, subdivide
from esd.population.template import as_template, medoid, shape_dna


def test_the_medoid_is_the_row_nearest_to_the_others():
    rows = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [9.0, 9.0]])
    assert medoid(list(rows)) == 2  # 1.41 + 1 + 11.3, next 1 + 1 + 12.0
    assert medoid(list(rows[:3])) == 1


def test_shape_dna_of_a_sphere_is_its_spectrum_over_weyls_law():
    mesh = icosphere(4)
    found = shape_dna(Shape("a", "a", "t", lambda: Mesh(7 * mesh.vertices, mesh.faces), list))
    degree = np.repeat(np.arange(1, 7), 2 * np.arange(1, 7) + 1)  # multiplicity 2 l + 1
    # λ = l (l + 1) on the unit sphere, of area 4 π; one on which it is 1 has 4 π times that
    expected = (degree * (degree + 1) / np.arange(1, len(degree) + 1))[:48]
    assert found[:48] == pytest.approx(expected, rel=0.02)  # linear elements on 2,562 vertices


def test_a_template_is_repaired_and_remeshed_only_where_it_is_dense():
    mesh = icosphere(3)
    loose = Mesh(np.vstack([mesh.vertices, [[5.0, 5.0, 5.0]]]), mesh.faces)
    assert len(as_template(loose, vertex_count=1000).vertices) == len(mesh.vertices)
    coarse = as_template(subdivide(mesh), vertex_count=1000)
    assert 900 < len(coarse.vertices) < 1100
