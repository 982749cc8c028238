import numpy as np
import pytest

from esd.mesh.geometry import is_consistently_oriented
from esd.mesh.mesh import Mesh
from esd.mesh.remesh import dual as cells
from esd.mesh.remesh.density import density_and_metric
from esd.mesh.remesh.dual import dual, spread_sites
from esd.mesh.remesh.refinement import refined
from esd.mesh.remesh.styles import STYLES
from esd.mesh.shapes import icosphere, torus
from esd.mesh.topology import edge_table, fan_count


@pytest.mark.parametrize(("mesh", "euler"), [(icosphere(3), 2), (torus(30, 15), 0)])
def test_the_triangles_of_sites_are_a_manifold_of_the_same_topology(mesh, euler):
    fine = refined(mesh, 0.15)
    density, metric = density_and_metric(mesh, fine, STYLES["even"])
    sites = spread_sites(fine, density, metric, 120, 3, 0)
    assert len(np.unique(sites)) == len(sites) == 120
    sites, cell, faces = dual(fine, metric, sites)
    np.testing.assert_array_equal(cell[sites], np.arange(len(sites)))
    table = edge_table(faces, len(sites))
    assert (table.count == 2).all()
    assert (fan_count(faces, table, len(sites)) == 1).all()
    assert len(sites) - len(table.ends) + len(faces) == euler
    assert is_consistently_oriented(Mesh(fine.mesh.vertices[sites], faces))


def test_more_rounds_spread_sites_more_evenly():
    mesh = icosphere(4)
    fine = refined(mesh, 1.0)
    density, metric = density_and_metric(mesh, fine, STYLES["even"])
    shortest = []
    for rounds in (0, 5):
        points = fine.mesh.vertices[spread_sites(fine, density, metric, 50, rounds, 0)]
        gap = np.linalg.norm(points[:, None] - points, axis=2)
        shortest.append(gap[np.triu_indices(50, 1)].min())
    assert shortest[1] > 2 * shortest[0]


def test_cells_of_more_sites_are_those_computed_anew(blob):
    fine = refined(blob, 0.1)
    _, metric = density_and_metric(blob, fine, STYLES["graded"])
    count = metric.shape[0]
    sites = np.sort(np.random.default_rng(0).choice(count, 40, replace=False))
    grown = np.union1d(sites, np.random.default_rng(1).choice(count, 15, replace=False))
    cell, distance = cells._with_more(metric, sites, grown, *cells._cells(metric, sites))
    expected, length = cells._cells(metric, grown)
    np.testing.assert_allclose(distance, length, rtol=1e-12)
    assert (cell == expected).mean() > 0.999  # vertices as near to two sites go to either
