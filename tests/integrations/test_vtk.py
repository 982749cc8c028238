"""Files for ParaView and 3D Slicer, read by VTK itself."""

import json

import numpy as np
import pytest

from esd.matching.correspondence import Correspondence
from esd.mesh.io.attributes import write_with_attributes
from esd.mesh.io.landmarks import Landmarks, write_landmarks
from esd.mesh.shapes import torus

vtk = pytest.importorskip("vtk", reason="VTK is not installed")
from vtk.util.numpy_support import vtk_to_numpy  # noqa: E402


def test_a_mesh_with_its_matches_is_read(tmp_path):
    mesh = torus(24, 16)
    count = len(mesh.vertices)
    index = np.arange(count)[::-1].copy()
    match = Correspondence(index, np.linspace(0, 1, count), np.linspace(1, 0, count))
    write_with_attributes(mesh, match.attributes(), tmp_path / "a.vtp")
    reader = vtk.vtkXMLPolyDataReader()
    reader.SetFileName(str(tmp_path / "a.vtp"))
    reader.Update()
    found = reader.GetOutput()
    np.testing.assert_array_equal(vtk_to_numpy(found.GetPoints().GetData()), mesh.vertices)
    faces = vtk_to_numpy(found.GetPolys().GetConnectivityArray()).reshape(-1, 3)
    np.testing.assert_array_equal(faces, mesh.faces)
    for name, values in match.attributes().items():
        read = vtk_to_numpy(found.GetPointData().GetArray(name))
        np.testing.assert_array_equal(read, values)


def test_landmarks_are_markups_of_slicer(tmp_path):
    mesh = torus(24, 16)
    marks = Landmarks(("nose", "tail"), np.array([3, 200]))
    write_landmarks(marks, mesh, tmp_path / "a.mrk.json")
    document = json.loads((tmp_path / "a.mrk.json").read_text())
    assert "markups-schema-v1." in document["@schema"]
    (markup,) = document["markups"]
    assert markup["type"] == "Fiducial"
    assert markup["coordinateSystem"] == "LPS"
    places = [point["position"] for point in markup["controlPoints"]]
    np.testing.assert_allclose(places, mesh.vertices[[3, 200]])
