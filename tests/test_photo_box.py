"""The rectangle in a photo: what is one, and what is said of what is none."""

from __future__ import annotations

import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from capture2vr.order.photo_box import WHOLE, InvalidBox, PhotoBox

places = st.floats(0, 1)


@given(places, places, places, places)
def test_four_numbers_are_a_rectangle_in_the_photo_or_an_error(
    left: float, top: float, right: float, bottom: float
) -> None:
    values = (left, top, right, bottom)
    if (right - left >= 0.01 and bottom - top >= 0.01) or (left, top) == (right, bottom):
        assert PhotoBox.of(values).values == values
    else:
        with pytest.raises(InvalidBox):
            PhotoBox.of(values)


@given(places, places, st.sampled_from(["", "a, b.jpg"]))
def test_two_numbers_are_a_tap_whatever_way_it_goes(x: float, y: float, photo: str) -> None:
    tap = PhotoBox.of([x, y, photo] if photo else [x, y])
    assert tap.is_tap
    assert tap.values == (x, y, x, y)
    assert PhotoBox.parse(tap.text) == PhotoBox.of(tap.as_json) == PhotoBox.unchecked(tap.as_json) == tap
    assert PhotoBox.of([*tap.values, photo]) == tap


@given(places, places, places, places, st.floats(0, 3))
def test_a_grown_rectangle_holds_the_smaller_and_stays_in_the_photo(
    left: float, top: float, right: float, bottom: float, share: float
) -> None:
    box = PhotoBox(min(left, right), min(top, bottom), max(left, right), max(top, bottom))
    grown = box.grown(share)
    assert 0 <= grown.left <= box.left <= box.right <= grown.right <= 1
    assert 0 <= grown.top <= box.top <= box.bottom <= grown.bottom <= 1


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "not four numbers"),
        ("a,b,c,d", "not four numbers"),
        ("0.1,0.2,0.3", "3 numbers instead of four"),
        ("0.1", "1 numbers instead of four"),
        ("0.1,1.2", "reaches beyond the photo"),
        ("0.1,0.2,0.3,0.4,0.5", "a photo's name is a text"),
        ("0.1,0.2,0.3,0.4,0.5,0.6", "6 numbers instead of four"),
        ("photo=a.jpg", "not four numbers"),
        ("0.1,0.2,0.3,photo=a.jpg", "not four numbers"),
        ("0.1,0.2,0.3,0.4,photo=" + "a" * 201, "at most 200 characters"),
        ("0.1,0.2,0.3,0.4,photo=a\x1b[2Jb.jpg", "no control characters"),
        ("120,80,900,700", "reaches beyond the photo"),
        ("-0.1,0.2,0.5,0.6", "reaches beyond the photo"),
        ("0.1,0.2,0.5,1.01", "reaches beyond the photo"),
        ("0.5,0.2,0.1,0.6", "empty"),
        ("0.1,0.6,0.5,0.2", "empty"),
        ("0.1,0.2,0.1,0.6", "empty"),
        ("0.1,0.2,0.105,0.6", "narrower than 1%"),
        ("nan,0.2,0.5,0.6", "not finite"),
        ("0.1,0.2,inf,0.6", "not finite"),
    ],
)
def test_what_is_none_is_told_why(text: str, reason: str) -> None:
    with pytest.raises(InvalidBox, match=reason):
        PhotoBox.parse(text)


@pytest.mark.parametrize("values", [["a", 0, 1, 1], [0, 0, 1, 1, ["a.jpg"]], [0, 0, 1, None], [[], 0, 1, 1]])
def test_values_of_other_kinds_are_none(values: list[Any]) -> None:
    with pytest.raises(InvalidBox, match="not four numbers"):
        PhotoBox.of(values)


def test_a_rectangle_may_name_its_photo_whatever_that_is_called() -> None:
    box = PhotoBox.parse("0.125,0.25,0.5,1,photo=walk, 2/photo=3.jpg")
    assert (box.values, box.photo) == ((0.125, 0.25, 0.5, 1.0), "walk, 2/photo=3.jpg")
    assert PhotoBox.parse(box.text) == PhotoBox.parse(str(box)) == PhotoBox.of(box.as_json) == box
    assert box.grown(0.1).photo == box.photo


def test_what_is_written_can_be_read() -> None:
    box = PhotoBox.parse("0.125, 0.25,0.5,1")
    assert PhotoBox.parse(str(box)) == box
    assert math.isclose(box.width, 0.375)
    assert str(WHOLE) == "0,0,1,1"
