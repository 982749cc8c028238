import json

import numpy as np
import pytest

from esd.common import InputError
from esd.mesh.io.landmarks import LANDMARK_FORMATS, Landmarks, read_landmarks, write_landmarks
from esd.mesh.mesh import Mesh
from esd.mesh.shapes import grid, torus

SHAPE = torus(20, 15)
SHAPE = Mesh(SHAPE.vertices * [1.0, 1.3, 0.8] + [5, 2, 1], SHAPE.faces)  # no axis maps it to itself


@pytest.mark.parametrize("suffix", LANDMARK_FORMATS)
def test_landmarks_come_back(tmp_path, suffix):
    landmarks = Landmarks(("1", "2", "3"), np.array([5, -1, 200]))
    write_landmarks(landmarks, SHAPE, tmp_path / f"l{suffix}")
    back = read_landmarks(tmp_path / f"l{suffix}", SHAPE)
    if suffix == ".fcsv":  # which has no way to say that one is missing
        assert back.names == ("1", "3")
        np.testing.assert_array_equal(back.vertices, [5, 200])
    else:
        assert back.names == ("1", "2", "3")
        np.testing.assert_array_equal(back.vertices, [5, -1, 200])


def test_csv_names_vertices_or_positions(tmp_path):
    mesh = grid(4, 3)
    path = tmp_path / "l.csv"
    write_landmarks(Landmarks(("nose", "ear"), np.array([5, -1])), mesh, path)
    assert path.read_text().splitlines()[2] == "ear,-1,,,"
    path.write_text("name,vertex\nnose,5\near,0\nchin,\n")
    landmarks = read_landmarks(path, mesh)
    assert landmarks.names == ("nose", "ear", "chin")
    np.testing.assert_array_equal(landmarks.vertices, [5, 0, -1])
    x, y, z = mesh.vertices[7] + 0.01
    path.write_text(f"name, x, y, z\nnose,{x},{y},{z}\near,nan,nan,nan\nchin,,,\neye,NA,NA,NA\n")
    np.testing.assert_array_equal(read_landmarks(path, mesh).vertices, [7, -1, -1, -1])


def test_points_inside_large_faces_are_on_the_surface(tmp_path):
    mesh = grid(2, 2)  # two triangles
    (tmp_path / "l.csv").write_text("name,x,y,z\nmiddle,0.45,0.5,0\n")
    assert len(read_landmarks(tmp_path / "l.csv", mesh).vertices) == 1


def fcsv(system: str) -> str:
    rows = "".join(
        f"vtkMRML_{i},{x},{y},{z},0,0,0,1,1,1,0,L{i},,\n"
        for i, (x, y, z) in enumerate(SHAPE.vertices[::17].tolist())
    )
    return (
        f"# Markups fiducial file version = 4.11\n# CoordinateSystem = {system}\n"
        f"# columns = id,x,y,z,ow,ox,oy,oz,vis,sel,lock,label,desc,associatedNodeID\n{rows}"
    )


def mrk(system: str) -> str:
    points = [
        {"label": f"L{i}", "position": place, "positionStatus": "defined"}
        for i, place in enumerate(SHAPE.vertices[::17].tolist())
    ]
    return json.dumps({"markups": [{"coordinateSystem": system, "controlPoints": points}]})


@pytest.mark.parametrize(("suffix", "make"), [(".fcsv", fcsv), (".mrk.json", mrk)])
def test_coordinate_systems_of_slicer_are_obeyed(tmp_path, suffix, make):
    path = tmp_path / f"l{suffix}"
    path.write_text(make("LPS"))
    np.testing.assert_array_equal(read_landmarks(path, SHAPE).vertices, range(0, 300, 17))
    path.write_text(make("RAS"))
    turned = Mesh(SHAPE.vertices * [-1, -1, 1], SHAPE.faces)
    np.testing.assert_array_equal(read_landmarks(path, turned).vertices, range(0, 300, 17))
    with pytest.raises(InputError, match=r"With x and y negated \(LPS for RAS\) they would"):
        read_landmarks(path, SHAPE)
    path.write_text(make("XYZ"))
    with pytest.raises(InputError, match="coordinate system 'XYZ'; expected LPS or RAS"):
        read_landmarks(path, SHAPE)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda p: p * 1000, r"millimetres to metres \(times 0.001\)"),
        (lambda p: p / 25.4, r"inches to millimetres \(times 25.4\)"),
        (lambda p: p * [1, 1, -1], "z negated"),
        (lambda p: p[:, [0, 2, 1]] * [1, -1, 1], r"\(x, y, z\) as \(x, z, -y\)"),
        (lambda p: p * [-10, -10, 10], r"centimetres \(times 0.1\) and x and y negated"),
        (lambda p: p + 50, "Check that they belong to this mesh"),
        (lambda p: p + 1e308, "Check that they belong to this mesh"),  # its square is infinite
    ],
)
def test_points_off_the_surface_are_refused_with_what_explains_it(tmp_path, change, message):
    points = change(SHAPE.vertices[::17])
    rows = "".join(f"L{i},{x},{y},{z}\n" for i, (x, y, z) in enumerate(points.tolist()))
    (tmp_path / "l.csv").write_text("name,x,y,z\n" + rows)
    with pytest.raises(InputError, match=rf"landmark 'L\d+' is [\d.e+]+ from the mesh.*{message}"):
        read_landmarks(tmp_path / "l.csv", SHAPE)


def test_pts_and_tps_of_other_programs(tmp_path):
    lines = [" ".join(map(str, row)) for row in SHAPE.vertices[:3].tolist()]
    for text in ("\n".join(lines), "3\n" + "\n".join(lines)):
        (tmp_path / "l.pts").write_text(text)
        landmarks = read_landmarks(tmp_path / "l.pts", SHAPE)
        assert landmarks.names == ("1", "2", "3")
        np.testing.assert_array_equal(landmarks.vertices, range(3))
    (tmp_path / "l.pts").write_text("Version 1.0\nS\n1\nS000 " + lines[1])
    assert read_landmarks(tmp_path / "l.pts", SHAPE).names == ("S000",)
    half = [" ".join(str(x / 2) for x in row) for row in SHAPE.vertices[:3].tolist()]
    (tmp_path / "l.tps").write_text("LM3=3\n" + "\n".join(half) + "\nID=skull\nSCALE=2\n")
    np.testing.assert_array_equal(read_landmarks(tmp_path / "l.tps", SHAPE).vertices, range(3))


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("l.csv", b"a,b\n1,2\n", "name,vertex or name,x"),
        ("l.csv", b"", "name,vertex or name,x"),
        ("l.csv", b"name,vertex\n", "holds no landmarks"),
        ("l.csv", b"name,vertex\nx,y\n", "something else than landmarks"),
        ("l.csv", b"name,vertex\nx,9\n", "from 0 to 8"),
        ("l.csv", b"name,vertex\nx,-2\n", "from -2"),
        ("l.csv", b"\xff\xfe\x00\xd8", "is no text"),
        ("l.csv", None, "There is no file"),
        ("l.mrk.json", b"{}", "something else than landmarks: 'markups'"),
        ("l.mrk.json", b"[]", "something else than landmarks"),
        ("l.mrk.json", b"hello", "something else than landmarks"),
        ("l.pts", b"version: 1\nn_points: 68\n{\n1 2\n}\n", "holds no landmarks"),
        ("l.pts", b"version: 1 2\n1 2 3\n", "points of an image"),
        ("l.pts", b"1 2 3 4 5\n", "no landmark: '1 2 3 4 5'"),
        ("l.pts", b"5\n0 0 0\n", "announces 5 landmarks and has 1"),
        ("l.tps", b"LM=1\n0 0\n", "one specimen with LM3="),
        ("l.tps", b"LM3=2\n0 0 0\n", "announces 2 landmarks and has 1"),
        ("l.tps", b"LM3=1\n0 0\n", "a position of 2 numbers"),
        ("l.txt", b"", r"end in .csv, .fcsv, .mrk.json, .pts, .tps"),
    ],
)
def test_bad_files_are_refused(tmp_path, name, content, message):
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=message):
        read_landmarks(tmp_path / name, grid(3, 3))


def test_files_that_cannot_be_opened_are_refused(tmp_path, monkeypatch):
    def no(*_, **__):
        raise OSError("out of order")

    (tmp_path / "l.csv").write_text("name,vertex\n")
    monkeypatch.setattr("pathlib.Path.read_text", no)
    with pytest.raises(InputError, match="cannot be read: out of order"):
        read_landmarks(tmp_path / "l.csv", SHAPE)
