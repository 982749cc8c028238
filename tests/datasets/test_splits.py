from esd.datasets.collection import Collection, Shape
from esd.datasets.splits import sample_by_subject, sample_subjects, unseen_subjects


def test_splits_and_samples_go_by_subject():
    shapes = [Shape(f"{s}{i}", s, "t", None, None) for s in "abcdefgh" for i in range(12)]
    collection = Collection("x", tuple(shapes))
    training, testing = unseen_subjects(collection)
    assert testing.subjects == ("g", "h")
    assert training.subjects == tuple("abcdef")
    training, testing = unseen_subjects(collection, patterns="a1")
    assert [shape.name for shape in testing.shapes] == ["a1"]
    assert training.subjects == tuple("bcdefgh")
    _, testing = unseen_subjects(Collection("x", tuple(shapes), ("b",)))
    assert testing.subjects == ("b",)
    assert unseen_subjects(collection, least=4)[1].subjects == tuple("efgh")
    some = sample_subjects(collection, 3, seed=1)
    assert len(some.subjects) == 3
    assert len(some.shapes) == 36
    assert some.subjects != sample_subjects(collection, 3, seed=2).subjects
    assert sample_subjects(collection, 9) == collection
    sample = sample_by_subject(collection, 5, seed=1)
    assert [sum(s.subject == k for s in sample.shapes) for k in "abcdefgh"] == [5] * 8
    assert sample != sample_by_subject(collection, 5, seed=2)
    assert sample_by_subject(collection, 12) == collection
