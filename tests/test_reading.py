"""Columns of a table as a person writes them."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from capture2vr.order.reading import InvalidColumns, TableColumns

NAMES = ("x", "y", "z", "r", "g", "b", "nx", "ny", "nz", "i")


@given(st.permutations(range(1, 11)), st.booleans(), st.booleans(), st.booleans(), st.randoms())
def test_what_is_written_is_what_is_parsed(numbers, rgb, normals, intensity, random) -> None:  # type: ignore[no-untyped-def]
    wanted = NAMES[:3] + NAMES[3:6] * rgb + NAMES[6:9] * normals + NAMES[9:] * intensity
    at = dict(zip(NAMES, numbers, strict=True))
    parts = [f"{name} = {at[name]}" for name in wanted]
    random.shuffle(parts)
    found = TableColumns.parse(", ".join(parts))
    assert found.used == tuple(at[name] - 1 for name in wanted)
    assert TableColumns.parse(found.as_text) == found


@pytest.mark.parametrize(
    "text",
    [
        "",
        "x=1,y=2",
        "x=1,y=2,z=2",
        "x=0,y=1,z=2",
        "x=1,y=2,z=3,r=4",
        "x=1,x=2,y=3,z=4",
        "x=1,y=2,z=3,w=4",
        "1,2,3",
        "x" * 999,
    ],
)
def test_what_are_no_columns_is_refused(text: str) -> None:
    with pytest.raises(InvalidColumns):
        TableColumns.parse(text)
