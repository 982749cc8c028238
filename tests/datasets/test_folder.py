import numpy as np
import pytest

from esd.common import InputError
from esd.datasets.collection import repaired_shape
from esd.datasets.folder import folder_collection, read_vts
from esd.mesh.io.meshes import write_mesh
from esd.mesh.shapes import torus


def test_meshes_of_one_connectivity_correspond_by_index(registered):
    collection = folder_collection(registered)
    assert collection.subjects == ("00", "01", "02")
    np.testing.assert_array_equal(collection.shapes[0].correspondence(), np.arange(30))
    pairs = [(s.name, t.name) for s, t in collection.pairs()]
    assert ("tr_reg_000", "tr_reg_001") not in pairs  # one subject
    assert len(pairs) == 10


def test_vts_files_count_from_one(remeshed):
    collection = folder_collection(remeshed)
    np.testing.assert_array_equal(collection["cat0"].correspondence(), [2, 0, 19])
    np.testing.assert_array_equal(collection["cat0"].symmetric(), [0, 2, 19])
    assert collection["cat1"].symmetric is None
    (remeshed / "corres" / "cat1.vts").write_text("3\n0\n20\n")  # 0: the shape lacks the point
    np.testing.assert_array_equal(collection["cat1"].correspondence(), [2, -1, 19])
    assert [(s.name, t.name) for s, t in collection.pairs()] == [("cat0", "cat1"), ("cat1", "cat0")]


def test_names_of_tosca_are_classes_only_where_all_shapes_have_such(remeshed):
    for folder, suffix in (("shapes", "off"), ("corres", "vts")):
        first = remeshed / folder / f"cat0.{suffix}"
        (remeshed / folder / f"wolf0.{suffix}").write_bytes(first.read_bytes())
    assert folder_collection(remeshed).unregistered() == ("wolf0",)
    for folder, suffix in (("shapes", "off"), ("corres", "vts")):
        first = remeshed / folder / f"cat0.{suffix}"
        (remeshed / folder / f"cow_alph4.{suffix}").write_bytes(first.read_bytes())
    collection = folder_collection(remeshed)
    assert collection.unregistered() == ()
    assert len(collection.pairs()) == 12  # four animals, each a subject of its own


def test_parts_are_named_at_the_points_of_the_template(remeshed):
    parts = remeshed / "parts"
    parts.mkdir()
    (parts / "names.txt").write_text("head\nleft hand\n")
    (parts / "cat0.txt").write_text("1\n" + "0\n" * 19)
    collection = folder_collection(remeshed)
    assert collection["cat0"].parts().tolist() == ["head", "left hand", "head"]
    assert collection["cat1"].parts is None
    for text in ("0\n" * 19, "0\n" * 19 + "2\n", "-1\n" * 20):
        (parts / "cat0.txt").write_text(text)
        with pytest.raises(InputError, match=r"must hold a number from 0 to 1, .* lie on 20"):
            collection["cat0"].parts()
    (parts / "cat0.txt").write_text("head\n")
    with pytest.raises(InputError, match="parts of 'cat0' cannot be read: expected a number"):
        collection["cat0"].parts()
    (parts / "names.txt").unlink()
    with pytest.raises(InputError, match="parts of 'cat0' cannot be read"):
        collection["cat0"].parts()


def test_parts_of_registered_meshes(registered):
    (registered / "parts").mkdir()
    (registered / "parts" / "names.txt").write_text("body\n")
    (registered / "parts" / "tr_reg_001.txt").write_text("0\n" * 30)
    collection = folder_collection(registered)
    assert set(collection["tr_reg_001"].parts()) == {"body"}
    assert collection["tr_reg_000"].parts is None


def test_listed_subjects_override_names(registered):
    (registered / "subjects.csv").write_text("name,subject\ntr_reg_000,ann\ntr_reg_001,bob\n")
    assert folder_collection(registered).subjects == ("ann", "bob", "01", "02")
    (registered / "subjects.csv").write_text("shape\ntr_reg_000\n")
    with pytest.raises(InputError, match="columns name,subject"):
        folder_collection(registered)
    (registered / "subjects.csv").write_text("name,subject\ntr_reg_000,\n")
    with pytest.raises(InputError, match="line 2: expected a name and a subject"):
        folder_collection(registered)
    (registered / "subjects.csv").write_bytes(b"name,subject\n\xff\xfe,a\n")
    with pytest.raises(InputError, match=r"subjects\.csv' must be a CSV file in UTF-8"):
        folder_collection(registered)


def test_subjects_of_shapes_that_there_are_not_are_refused(registered):
    (registered / "subjects.csv").write_text("name,subject\ntr_reg_000.off,ann\ntr_reg_001,ann\n")
    with pytest.raises(InputError, match=r"names shapes that do not exist \(1\): tr_reg_000\.off"):
        folder_collection(registered)
    # as spreadsheets write it, with a byte order mark
    text = "\ufeffname,subject\ntr_reg_000,ann\n"
    (registered / "subjects.csv").write_text(text, encoding="utf-8")
    assert folder_collection(registered)["tr_reg_000"].subject == "ann"


def test_vts_files_of_different_lengths_are_refused(remeshed, monkeypatch):
    (remeshed / "corres" / "cat1.vts").write_text("3\n1\n")
    message = r"cat1\.vts' has 2 points and '.*cat0\.vts' 3: shapes that correspond"
    with pytest.raises(InputError, match=message):
        folder_collection(remeshed)
    monkeypatch.setattr("esd.datasets.folder._COMPARED", 1)  # the first
    collection = folder_collection(remeshed)
    with pytest.raises(InputError, match=message):
        collection["cat1"].correspondence()
    (remeshed / "corres" / "cat1.vts").write_text("3\n1\n0\n")
    np.testing.assert_array_equal(collection["cat1"].correspondence(), [2, 0, -1])
    (remeshed / "corres" / "wolf0.vts").write_text("3\n")  # of another template
    assert len(folder_collection(remeshed).pairs()) == 2
    (remeshed / "corres" / "cat0.sym.vts").write_text("1\n3\n")
    with pytest.raises(InputError, match=r"cat0\.sym\.vts' has 2 points"):
        folder_collection(remeshed)["cat0"].symmetric()


def test_vertices_that_are_not_finite_are_left_out(registered, caplog):
    mesh = torus(6, 5)
    lines = (registered / "tr_reg_001.off").read_text().splitlines()
    lines[2 + 7] = "nan 0 0"
    (registered / "tr_reg_001.off").write_text("\n".join(lines))
    collection = folder_collection(registered)
    assert collection.unregistered() == ()
    read = collection["tr_reg_001"].mesh()
    assert (
        "tr_reg_001.off': coordinates that are not finite at 1 of its vertices; these and their 6 faces"
        in caplog.text
    )
    assert len(read.faces) == len(mesh.faces) - 6
    assert not (read.faces == 7).any()
    _, index, _ = repaired_shape(collection["tr_reg_001"])
    assert index[7] == -1
    np.testing.assert_array_equal(np.delete(index, 7), np.delete(np.arange(30), 7))
    (registered / "tr_reg_001.off").write_text("OFF\n3 1 0\n0 0 0\n1 0 0\n0 nan 0\n3 0 1 5\n")
    with pytest.raises(InputError, match=r"tr_reg_001\.off': "):
        collection["tr_reg_001"].mesh()


def test_hidden_files_are_no_shapes(registered):
    (registered / "._tr_reg_000.off").write_bytes(b"\0\5\x16\7")
    assert len(folder_collection(registered).shapes) == 4


def test_broken_folders_are_refused(tmp_path, remeshed):
    with pytest.raises(InputError, match="There is no data set"):
        folder_collection(tmp_path / "none")
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="There is no mesh"):
        folder_collection(tmp_path / "empty")
    write_mesh(torus(6, 5), tmp_path / "empty" / "a.off")
    write_mesh(torus(6, 6), tmp_path / "empty" / "b.off")
    write_mesh(torus(6, 6), tmp_path / "empty" / "b.ply")
    with pytest.raises(InputError, match="several meshes named 'b'"):
        folder_collection(tmp_path / "empty")
    for file in (remeshed / "corres").iterdir():
        file.unlink()
    with pytest.raises(InputError, match="has no correspondence"):
        folder_collection(remeshed)


def test_meshes_of_several_connectivities_correspond_with_no_other(registered):
    write_mesh(torus(6, 6), registered / "tr_reg_011.off")
    collection = folder_collection(registered)
    assert collection.unregistered() == tuple(shape.name for shape in collection.shapes)
    assert collection.subjects == ("00", "01", "02")
    shape = collection["tr_reg_011"]
    np.testing.assert_array_equal(shape.correspondence(), np.arange(36))
    with pytest.raises(InputError, match="no two shapes that correspond"):
        collection.pairs()


def test_of_a_large_folder_each_mesh_is_checked_when_it_is_read(registered, monkeypatch):
    monkeypatch.setattr("esd.datasets.folder._COMPARED", 2)  # the first and the last
    write_mesh(torus(6, 6), registered / "tr_reg_010.off")
    collection = folder_collection(registered)
    assert collection.unregistered() == ()
    with pytest.raises(InputError, match=r"'tr_reg_010\.off' has another connectivity than"):
        collection["tr_reg_010"].mesh()


def test_meshes_that_cannot_be_read_do_not_decide_about_a_folder(registered):
    for name in ("tr_reg_010", "tr_reg_000", "tr_reg_020"):
        (registered / f"{name}.off").write_text("OFF\n")
        assert folder_collection(registered).unregistered() == ()
    (registered / "tr_reg_001.off").write_text("OFF\n")
    with pytest.raises(InputError, match=r"tr_reg_020\.off' cannot be read"):
        folder_collection(registered)


def test_shapes_that_lack_a_correspondence_are_reported(remeshed, caplog):
    (remeshed / "corres" / "cat1.vts").unlink()
    collection = folder_collection(remeshed)
    assert "1 of 3 shapes have no correspondence" in caplog.text
    assert "cat1.off" in caplog.text
    assert collection.unregistered() == ("cat0", "cat1", "wolf0")  # no other cat is left


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("-1\n1\n", "count vertices from 1, 0 for none"),
        ("0\n0\n", "names no vertex"),
        ("a\n", "one vertex index a line"),
        ("", "is empty"),
    ],
)
def test_bad_vts_files_are_refused(tmp_path, text, message):
    (tmp_path / "x.vts").write_text(text)
    with pytest.raises(InputError, match=message):
        read_vts(tmp_path / "x.vts")
    with pytest.raises(InputError, match="There is no correspondence"):
        read_vts(tmp_path / "y.vts")


def test_landmarks_of_some_shapes_are_read(registered):
    (registered / "landmarks").mkdir()
    (registered / "landmarks" / "tr_reg_010.csv").write_text("name,vertex\nnose,3\near,7\n")
    collection = folder_collection(registered)
    assert collection["tr_reg_000"].landmarks is None
    landmarks = collection["tr_reg_010"].landmarks()
    assert landmarks.names == ("nose", "ear")
    np.testing.assert_array_equal(landmarks.vertices, [3, 7])
