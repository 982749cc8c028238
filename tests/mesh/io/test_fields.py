import numpy as np
import pytest

from esd.common import InputError
from esd.mesh.io.fields import (
    read_labels,
    read_values,
    write_labels,
    write_values,
)


@pytest.mark.parametrize("suffix", ["npy", "txt"])
def test_labels_and_values_come_back(tmp_path, suffix):
    path = tmp_path / f"f.{suffix}"
    write_labels(np.array([3, -1, 0]), path)
    labels, names = read_labels(path)
    np.testing.assert_array_equal(labels, [3, -1, 0])
    assert names is None
    for values in (np.array([0.5, np.nan, 2.0]), np.arange(6.0).reshape(3, 2)):
        write_values(values, path)
        np.testing.assert_array_equal(read_values(path), values)


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ("1,,3\n4,5,NA\n", [[1, np.nan, 3], [4, 5, np.nan]]),  # cells keep their columns
        ("1,\n,2\n", [[1, np.nan], [np.nan, 2]]),
        ("1;2,5\n3;4\n", [[1, 2.5], [3, 4]]),
        ("a,b\n1, 2\n\n3, 4\n", [[1, 2], [3, 4]]),
        ("\ufeffvalue\n1\n-.5\n", [1, -0.5]),
        ("1 2\n3\t4\n", [[1, 2], [3, 4]]),
        ("nan\ninf\n", [np.nan, np.inf]),
    ],
)
def test_values_are_read_as_other_programs_write_them(tmp_path, text, values):
    path = tmp_path / "v.csv"
    path.write_text(text, encoding="utf-8")
    np.testing.assert_array_equal(read_values(path), values)


def test_labels_may_be_words(tmp_path):
    path = tmp_path / "parts.txt"
    path.write_text("left arm\nhead\nleft arm\n")
    labels, names = read_labels(path)
    np.testing.assert_array_equal(labels, [1, 0, 1])
    write_labels(np.array([0, 1, -1]), path, names)
    assert path.read_text().splitlines() == ["head", "left arm", "none"]


@pytest.mark.parametrize(
    ("read", "name", "content", "message"),
    [
        (read_labels, "f.txt", b"", "is empty"),
        (read_labels, "f.txt", b"\xff\xfe\x00\xd8", "is no text"),
        (read_labels, "f.npy", b"hello", "holds no array"),
        (read_labels, "f.xml", b"", "ends in .npy, .csv, .txt"),
        (read_values, "f.txt", b" \n", "is empty"),
        (read_values, "f.txt", b"1\nabc\n", "must hold numbers"),
        (read_values, "no.txt", None, "There is no file"),
    ],
)
def test_bad_files_are_refused(tmp_path, read, name, content, message):
    path = tmp_path / name
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError, match=message):
        read(path)


def test_arrays_of_other_kinds_are_refused(tmp_path):
    np.save(tmp_path / "f.npy", np.array([0.5]))
    with pytest.raises(InputError, match="integers of shape"):
        read_labels(tmp_path / "f.npy")
    np.save(tmp_path / "f.npy", np.array(["a"]))
    with pytest.raises(InputError, match="must hold numbers"):
        read_values(tmp_path / "f.npy")
