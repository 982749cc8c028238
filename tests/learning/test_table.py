from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from bent import RECIPE, bent, bent_shapes, points
from esd.common import InputError
from esd.datasets.collection import Collection
from esd.learning.table import point_table, standardisation
from esd.mesh.shapes import torus
from esd.parallel import Workers


@pytest.fixture
def collection() -> Collection:
    return bent_shapes(range(3))


@pytest.mark.parametrize("count", [None, 30])
def test_tables_are_the_same_by_any_number_of_processes(collection, count):
    here = point_table(collection, RECIPE, points=count)
    there = point_table(collection, RECIPE, points=count, workers=Workers(2))
    np.testing.assert_allclose(there.values, here.values, rtol=1e-5)  # float32, other threads
    for one, other in zip(here.rows, there.rows, strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("count", [30, 59, 60, 100, 500])
def test_tables_of_some_points_hold_rows_of_the_whole(collection, count):
    # of fewer than 60 points each shape may lack one; more leave all of its 96 to 120 vertices
    whole, some = point_table(collection, RECIPE), point_table(collection, RECIPE, points=count)
    if count < 60:
        assert 3 * (count - 1) <= len(some.values) <= 3 * count
    else:
        np.testing.assert_array_equal(some.values, whole.values)
    for all_rows, rows in zip(whole.rows, some.rows, strict=True):
        known = rows[rows >= 0]
        assert len(np.unique(known)) == len(known)
        values = {row.tobytes() for row in whole.values[all_rows[all_rows >= 0]]}
        assert {row.tobytes() for row in some.values[known]} <= values


def test_missing_points_have_no_row_and_others_their_own(collection):
    table = point_table(collection, RECIPE)
    start = 0
    for i, rows in enumerate(table.rows):
        np.testing.assert_array_equal(np.where(rows >= 0, rows - start, -1), points(i))
        start += len(bent(i).vertices)
    assert start == len(table.values)


def test_shapes_that_fail_are_named(collection):
    beyond = replace(collection.shapes[1], correspondence=partial(np.arange, 10**4))
    broken = replace(collection, shapes=(collection.shapes[0], beyond))
    with pytest.raises(InputError, match="correspondence of 'c1' names vertex 9999"):
        point_table(broken, RECIPE, workers=Workers(2))
    small = replace(
        collection.shapes[2], mesh=partial(torus, 4, 3), correspondence=partial(np.arange, 9)
    )
    with pytest.raises(InputError, match="'c2': "):
        point_table(replace(collection, shapes=(small,)), RECIPE)


def test_standardisation_takes_no_notice_of_its_parts(collection, monkeypatch):
    table = point_table(collection, RECIPE)
    table.values[5] = np.nan  # a vertex without a face
    monkeypatch.setattr("esd.learning.table._CHUNK", 7)
    mean, deviation = standardisation(table)
    known = np.delete(table.values, 5, axis=0).astype(np.float64)
    np.testing.assert_allclose(mean, known.mean(axis=0), rtol=1e-12)
    np.testing.assert_allclose(deviation, known.std(axis=0), rtol=1e-9)
    changed = table.standardised(mean, deviation, limit=1.0)
    assert not np.shares_memory(changed.values, table.values)
    in_place = table.standardised(mean, deviation, limit=1.0, in_place=True)
    assert np.shares_memory(in_place.values, table.values)
    np.testing.assert_array_equal(in_place.values, changed.values)


def test_tables_of_16_bits_are_those_of_32_once_they_are_standardised(collection):
    whole = point_table(collection, RECIPE, points=30)
    half = point_table(collection, RECIPE, points=30, half=True, workers=Workers(2))
    assert half.values.dtype == np.float16
    moments = standardisation(whole)
    for found, expected in zip(standardisation(half), moments, strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-3)
    there, here = (
        table.standardised(*moments, limit=8.0, in_place=True) for table in (half, whole)
    )
    rows = whole.rows[1][whole.rows[1] >= 0]
    # rounded twice to 11 bits, of numbers of some deviations
    np.testing.assert_allclose(there.at(rows), here.at(rows), atol=5e-3)
    assert there.at(rows).dtype == np.float32


def test_standardised_columns_have_mean_zero_and_deviation_one(collection):
    table = point_table(collection, RECIPE)
    values = table.standardised(*standardisation(table)).values
    np.testing.assert_allclose(values.mean(axis=0), 0, atol=1e-4)
    np.testing.assert_allclose(values.std(axis=0), 1, atol=1e-4)
