import pytest

from esd.common import InputError
from esd.datasets.collection import Collection, read_pairs
from esd.datasets.folder import folder_collection
from esd.datasets.splits import split_by_subject


def test_selection_and_splits(registered):
    collection = folder_collection(registered)
    assert len(collection.including("tr_reg_00*, tr_reg_020").shapes) == 3
    with pytest.raises(InputError, match=r"No shape of .* matches 'x'"):
        collection.including("x")
    with pytest.raises(InputError, match="has no shape 'x'"):
        collection["x"]
    kept, held = split_by_subject(collection, held_out=1, seed=3)
    assert set(kept.subjects) | set(held.subjects) == set(collection.subjects)
    assert not set(kept.subjects) & set(held.subjects)
    with pytest.raises(InputError, match="`held_out` must be from 1 to 2"):
        split_by_subject(collection, held_out=3)
    with pytest.raises(InputError, match="is left without"):
        collection.excluding_subjects(collection.subjects)
    with pytest.raises(InputError, match="no two shapes"):
        Collection("one", collection.shapes[:1]).pairs()


def test_pairs_files(registered, remeshed, tmp_path):
    collection = folder_collection(tmp_path)  # shapes/ comes first
    file = tmp_path / "pairs"
    file.write_text("cat0\tcat1\n\n")
    assert [(s.name, t.name) for s, t in read_pairs(file, collection)] == [("cat0", "cat1")]
    for text, message in [
        ("cat0 cat1\n", "line 1: expected two shape names"),
        ("cat0\twolf0\n", "do not correspond"),
        ("cat0\tdog\n", "has no shape 'dog'"),
        ("\n", "lists no pair"),
    ]:
        file.write_text(text)
        with pytest.raises(InputError, match=message):
            read_pairs(file, collection)
    with pytest.raises(InputError, match="There is no file"):
        read_pairs(tmp_path / "none", collection)
    file.write_bytes(b"cat0\t\xff\n")
    with pytest.raises(InputError, match=r"pairs' cannot be read: byte 6 of it is no text"):
        read_pairs(file, collection)
