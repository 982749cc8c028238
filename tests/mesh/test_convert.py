from types import SimpleNamespace

import numpy as np
import pytest
import trimesh

from esd.common import InputError
from esd.mesh.convert import as_arrays, as_mesh
from esd.mesh.mesh import Mesh
from esd.mesh.shapes import torus

MESH = torus(7, 5)


def test_scenes_clouds_and_open3d_meshes_are_taken():
    part = trimesh.Trimesh(MESH.vertices, MESH.faces, process=False)
    scene = trimesh.Scene()
    scene.add_geometry(part)
    scene.add_geometry(part, transform=trimesh.transformations.translation_matrix([9, 0, 0]))
    assert len(as_mesh(scene).vertices) == 70
    assert np.ptp(as_mesh(scene).vertices[:, 0]) > 9
    vertices, faces = as_arrays(trimesh.PointCloud(MESH.vertices))
    assert (len(vertices), len(faces)) == (35, 0)
    with pytest.raises(InputError, match="scene has no meshes"):
        as_mesh(trimesh.Scene([trimesh.PointCloud(MESH.vertices)]))
    open3d = SimpleNamespace(vertices=MESH.vertices, triangles=MESH.faces)
    np.testing.assert_array_equal(as_mesh(open3d).faces, MESH.faces)


TRIANGLE = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])


def test_as_mesh_takes_what_holds_a_mesh():
    faces = np.array([[0, 1, 2]])
    trimesh = SimpleNamespace(vertices=TRIANGLE, faces=faces)
    meshio = SimpleNamespace(points=TRIANGLE, cells_dict={"triangle": faces})
    pyvista = SimpleNamespace(points=TRIANGLE, faces=np.array([3, 0, 1, 2]))
    for source in (Mesh(TRIANGLE, faces), (TRIANGLE, faces), trimesh, meshio, pyvista):
        np.testing.assert_array_equal(as_mesh(source).faces, faces)
    with pytest.raises(InputError, match="no triangles"):
        as_mesh(SimpleNamespace(points=TRIANGLE, cells_dict={"line": faces}))
    with pytest.raises(InputError, match="triangulate"):
        as_mesh(SimpleNamespace(points=TRIANGLE, faces=np.array([4, 0, 1, 2, 0])))
    with pytest.raises(InputError, match="Expected a mesh"):
        as_mesh(3)
