"""Range headers and etags, whatever clients send."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from capture2vr.gateway.routes.http_ranges import UnsatisfiableError, etag_matches, parse_range


@given(size=st.integers(0, 50), first=st.integers(0, 60), last=st.integers(0, 60))
def test_a_range_is_the_slice_it_says(size: int, first: int, last: int) -> None:
    content = bytes(range(size))
    try:
        part = parse_range(f"bytes={first}-{last}", None, "tag", size)
    except UnsatisfiableError:
        assert first >= size
        return
    assert (part is None) == (last < first)
    if part:
        assert content[slice(*part)] == content[first : last + 1]


@given(header=st.text(max_size=30))
def test_no_header_breaks_the_parsers(header: str) -> None:
    etag_matches(header, "tag")
    try:
        part = parse_range(header, header, "tag", 10)
    except UnsatisfiableError:
        return
    assert part is None or 0 <= part[0] < part[1] <= 10
