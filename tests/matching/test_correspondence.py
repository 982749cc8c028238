import logging

import numpy as np
import pytest

from esd.common import InputError
from esd.matching.correspondence import Correspondence, load_map, save_map

MATCH = Correspondence(
    np.array([2, -1, 0]), np.array([0.5, np.inf, 0.0]), np.array([0.9, 0.0, 1.0])
)


@pytest.mark.parametrize("suffix", [".csv", ".npy", ".txt", ".vts"])
def test_a_map_comes_back_with_its_path_alone(tmp_path, suffix):
    path = tmp_path / f"m{suffix}"
    MATCH.save(path)
    np.testing.assert_array_equal(load_map(path).target_index, MATCH.target_index)


def test_lines_in_any_order_keep_their_distances_and_confidences(tmp_path):
    path = tmp_path / "m.csv"
    save_map(MATCH, path)
    head, *lines = path.read_text().splitlines()
    path.write_text("\n".join([head, *lines[::-1], ""]))
    found = load_map(path, source_count=3, target_count=3)
    for name in ("target_index", "distance", "confidence"):
        np.testing.assert_array_equal(getattr(found, name), getattr(MATCH, name))


HEAD = "source,target,distance,confidence\n"
NPY = "\x93NUMPY\x01\x00v\x00{'descr': '<i8', 'fortran_order': False, 'shape': (3,), }".ljust(128)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("m.csv", HEAD + "0,1,0,1\n0,1,0,1\n2,0,0,1\n", "source vertex 0 has two lines"),
        ("m.csv", HEAD + "0,1,0,1\n2,1,0,1\n3,0,0,1\n", "source vertex 1 has no line"),
        ("m.csv", HEAD + "-1,1,0,1\n0,1,0,1\n1,0,0,1\n", "source vertex -1 is none"),
        (
            "m.csv",
            HEAD + "0,-5000,0,1\n1,1,0,1\n2,0,0,1\n",
            "names target vertex -5000; expected -1",
        ),
        ("m.csv", HEAD + "0,6000,0,1\n1,1,0,1\n2,0,0,1\n", "names target vertex 6000"),
        ("m.csv", HEAD + "0,1,0,1\n1,1,0,1\n2,0", "no line break: add one, if it is not cut short"),
        (
            "m.csv",
            HEAD + "0,1,0,1\n1\n2,0,0,1\n",
            "line 3: expected a whole number; the cell is empty",
        ),
        (
            "m.csv",
            HEAD + "0,1,0,1\n1,one,0,1\n2,0,0,1\n",
            "line 3: expected a whole number; got 'one'",
        ),
        ("m.csv", HEAD + "0,1,near,1\n1,1,0,1\n2,0,0,1\n", "line 2: could not convert"),
        ("m.csv", HEAD + f"0,{10**30},0,1\n1,1,0,1\n2,0,0,1\n", "holds no map"),
        ("m.csv", "a,b\n1,2\n", "expected the columns source,target"),
        ("m.csv", HEAD, "no line follows the names of its columns"),
        ("m.csv", "", "it is empty"),
        ("m.csv", "\xff\xfe\n", "holds no map"),
        ("m.txt", "1\n2\n3", "no line break"),
        ("m.txt", "1\n2\n-7\n", "names target vertex -7; expected 0"),
        ("m.txt", "1\n2\n4\n", "names target vertex 3 "),
        ("m.txt", "1\n2\n", "maps 2 vertices; the source mesh has 3"),
        ("m.txt", "1\n2\n3.5\n", "m.txt' holds no map: line 3: expected a whole number; got '3.5'"),
        ("m.txt", f"1\n{10**30}\n3\n", "line 2: expected a whole number; got '1000"),
        ("m.vts", " \n", "it is empty"),
        # numpy reads the header as Python
        ("m.npy", NPY.replace("(3,)", "(3,"), "m.npy' holds no array"),
        ("m.npy", NPY.replace("<i8", "<i9"), "m.npy' holds no array"),
        ("m.xyz", "1\n", "a map's file ends in"),
    ],
)
def test_damaged_maps_are_refused(tmp_path, name, content, message):
    path = tmp_path / name
    path.write_bytes(content.encode("latin-1"))
    with pytest.raises(InputError, match=message):
        load_map(path, source_count=3, target_count=3)


def test_a_map_that_may_count_from_zero_is_reported(tmp_path, caplog):
    path = tmp_path / "m.txt"
    path.write_text("0\n1\n2\n")
    with caplog.at_level(logging.WARNING):
        load_map(path, source_count=3, target_count=3)
    assert "if it counts vertices from 0 and not from 1" in caplog.text
    caplog.clear()
    path.write_text("0\n1\n3\n")
    load_map(path, source_count=3, target_count=3)
    assert caplog.text == ""


def test_it_shows_itself_in_a_line_and_drops_what_is_not_sure(blob):
    assert repr(MATCH) == "<Correspondence: 2 of 3 vertices matched>"
    assert MATCH.confident(0.95).target_index.tolist() == [-1, -1, 0]
    unknown = Correspondence(np.array([1]), np.array([np.nan]), np.array([np.nan]))
    assert unknown.confident(0.5).target_index.tolist() == [1]


@pytest.mark.parametrize("suffix", ["csv", "npy", "txt", "vts"])
def test_maps_come_back_as_they_were_saved(tmp_path, suffix):
    saved = Correspondence(
        np.array([2, -1, 0]), np.array([0.25, np.inf, 1.5]), np.array([0.5, 0.0, 0.125])
    )
    path = tmp_path / f"map.{suffix}"
    save_map(saved, path)
    back = load_map(path, source_count=3, target_count=3)
    np.testing.assert_array_equal(back.target_index, saved.target_index)
    if suffix == "csv":
        assert path.read_text().splitlines()[:2] == [
            "source,target,distance,confidence",
            "0,2,0.25,0.5",
        ]
        np.testing.assert_array_equal(back.distance, saved.distance)
        np.testing.assert_array_equal(back.confidence, saved.confidence)
    elif suffix != "npy":
        assert path.read_text() == "3\n0\n1\n"
    with pytest.raises(InputError, match="maps 3 vertices; the source mesh has 4"):
        load_map(path, source_count=4, target_count=3)
    with pytest.raises(InputError, match="names target vertex 2"):
        load_map(path, source_count=3, target_count=2)


def test_files_that_hold_no_map_are_refused(tmp_path):
    counts = {"source_count": 2, "target_count": 2}
    for name, content in [
        ("a.csv", b"from,to\n0,1\n"),
        ("b.csv", b"source,target\n0,x\n"),
        ("c.npy", b"garbage"),
        ("d.txt", b"one\n"),
    ]:
        (tmp_path / name).write_bytes(content)
        with pytest.raises(InputError, match=name):
            load_map(tmp_path / name, **counts)
    np.save(tmp_path / "e.npy", np.zeros((2, 2)))
    with pytest.raises(InputError, match=r"integers of shape \(n,\)"):
        load_map(tmp_path / "e.npy", **counts)
    np.save(tmp_path / "f.npy", np.array([{}, {}]), allow_pickle=True)
    with pytest.raises(InputError, match="holds no array"):
        load_map(tmp_path / "f.npy", **counts)
    with pytest.raises(InputError, match="ends in one of"):
        load_map(tmp_path / "g.xml", **counts)
    with pytest.raises(InputError, match="There is no file"):
        load_map(tmp_path / "g.csv", **counts)


def test_a_correspondence_shows_itself():
    match = Correspondence(
        np.array([2, 2, -1]), np.array([0.1, 0.2, np.inf]), np.array([0.5, 1, 0])
    )
    shown = match._repr_html_()
    assert "<td>2 (67%)</td>" in shown
    assert "different target vertices</th><td>1</td>" in shown
    assert shown.count("<rect") == 20
    unknown = np.full(3, np.nan)
    assert "confidence" not in Correspondence(match.target_index, unknown, unknown)._repr_html_()
    assert set(match.attributes()) == {"target", "distance", "confidence"}


@pytest.mark.parametrize("between", [";", "\t"])
def test_maps_of_spreadsheets_have_other_signs_between_columns(tmp_path, between):
    lines = ["source,target,distance,confidence", "1,0,0.5,1", "0,2,1e-3,0.25"]
    (tmp_path / "m.csv").write_text("\n".join([*lines, ""]).replace(",", between))
    found = load_map(tmp_path / "m.csv")
    np.testing.assert_array_equal(found.target_index, [2, 0])
    np.testing.assert_array_equal(found.confidence, [0.25, 1])


def test_maps_with_impossible_confidences_are_refused(tmp_path):
    for cell in ("7", "-0.1", "inf"):
        (tmp_path / "m.csv").write_text(f"source,target,distance,confidence\n0,0,0,{cell}\n")
        with pytest.raises(
            InputError, match=f"line 2: expected a number from 0 to 1; got '{cell}'"
        ):
            load_map(tmp_path / "m.csv")
