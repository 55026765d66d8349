"""A scan ends when its time is up, and its pages together are all that is wanted."""

from __future__ import annotations

from itertools import count

from hypothesis import given
from hypothesis import strategies as st

from capture2vr.gateway.search.listing import Search
from capture2vr.gateway.search.scan import SCAN_S, scan
from capture2vr.storage.catalogue.row_filter import RowFilter
from tests.gateway.search.pieces import expected, listing_of, row_named

LEAVES = [[row_named(f"{leaf}{row}", "shoe" if (leaf + row) % 3 else "") for row in range(4)] for leaf in range(1, 8)]


@given(st.sampled_from(["", "shoe", "nothing"]), st.integers(1, 30), st.sampled_from([0.0, SCAN_S / 3, SCAN_S * 2]))
def test_pages_of_limited_time_are_together_all_that_is_wanted(label: str, limit: int, seconds_a_leaf: float) -> None:
    wanted, found, after = RowFilter(label), [], ""
    for _ in range(40):
        clock = count()
        page = scan(listing_of(LEAVES), Search(wanted, after, limit), clock=lambda: next(clock) * seconds_a_leaf)  # noqa: B023
        assert len(page.rows) <= limit
        found += page.rows
        if page.next is None:
            break
        assert page.next > after
        after = page.next
    assert page.next is None
    assert tuple(found) == expected(LEAVES, wanted)


def test_a_scan_reads_no_further_than_its_time() -> None:
    clock = count()
    read = scan(listing_of(LEAVES), Search(RowFilter("nothing"), "", 9), clock=lambda: next(clock) * SCAN_S)
    assert (read.rows, read.next) == ((), "23")
