"""Search in a collection: bounds of date and size are included, and what lies between them is found."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime

from hypothesis import given
from hypothesis import strategies as st

from capture2vr.storage.catalogue.collection import Row
from capture2vr.storage.catalogue.row_filter import RowFilter
from tests.storage.catalogue.test_collection import rows

SECONDS = st.integers(0, 2**33)
SIZES = st.integers(1, 2**50)
listed = rows.filter(lambda row: not row.removed)


def at(second: int) -> datetime:
    return datetime.fromtimestamp(second, UTC)


@given(listed, SECONDS, SECONDS, SECONDS)
def test_an_asset_is_found_by_the_day_of_its_change(row: Row, first: int, second: int, third: int) -> None:
    low, middle, high = sorted((first, second, third))
    changed = replace(row, updated=middle)
    assert RowFilter(since=at(low), until=at(high)).accepts(changed)
    assert RowFilter(since=at(middle), until=at(middle)).accepts(changed)
    assert not RowFilter(since=at(middle + 1)).accepts(changed)
    assert not RowFilter(until=at(middle - 1)).accepts(changed)


@given(listed, SIZES, SIZES, SIZES)
def test_an_asset_is_found_by_its_size(row: Row, first: int, second: int, third: int) -> None:
    low, middle, high = sorted((first, second, third))
    sized = replace(row, bytes=middle)
    assert RowFilter(min_bytes=low, max_bytes=high).accepts(sized)
    assert not RowFilter(min_bytes=middle + 1).accepts(sized)
    assert not RowFilter(max_bytes=middle - 1).accepts(sized)


@given(listed)
def test_an_asset_of_unknown_size_is_found_only_where_no_size_is_asked_for(row: Row) -> None:
    unsized = replace(row, bytes=0)
    assert RowFilter().accepts(unsized)
    assert not RowFilter(min_bytes=0).accepts(unsized)
    assert not RowFilter(max_bytes=2**60).accepts(unsized)


@given(rows)
def test_removed_assets_are_found_only_where_they_are_asked_for(row: Row) -> None:
    assert RowFilter().accepts(row) is not row.removed
    assert RowFilter(state=row.state).accepts(row)
    assert not RowFilter(state="refined" if row.state != "refined" else "preview").accepts(row)
