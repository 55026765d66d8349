"""Apple's maker note: gravity is read, rebuilt alone, and nothing that is no note breaks the reader."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from capture2vr.order.apple_maker_note import acceleration_note, read_acceleration
from tests.support.photos.maker_notes import SECRET, apple_note

G = st.floats(-1, 1)


@given(st.tuples(G, G, G).filter(lambda down: 0.6 < np.linalg.norm(down) < 1.4))
def test_gravity_is_all_that_stays(down: tuple[float, float, float]) -> None:
    note = apple_note(down)
    assert read_acceleration(note) == pytest.approx(down, abs=1e-4)
    rebuilt = acceleration_note(note)
    assert read_acceleration(rebuilt) == pytest.approx(down, abs=2e-4)
    assert SECRET not in rebuilt
    assert len(rebuilt) < len(note)
    assert acceleration_note(rebuilt) == rebuilt


@pytest.mark.parametrize(
    "note",
    [
        b"",
        b"MAKER" * 40,
        apple_note((0, 0, 0)),
        apple_note((0, -4, 0)),
        apple_note((0, -1, 0), denominators=(1, 0, 1)),
        apple_note((0, -1, 0))[:40],
    ],
    ids=["empty", "another maker's", "weightless", "thrown", "a division by zero", "cut short"],
)
def test_a_note_without_gravity_goes_whole(note: bytes) -> None:
    assert read_acceleration(note) is None
    assert acceleration_note(note) == b""


@given(st.binary(max_size=80))
def test_any_bytes_are_an_answer(tail: bytes) -> None:
    read_acceleration(b"Apple iOS\0\0\1MM" + tail)


@given(st.integers(0, 107), st.integers(0, 255))
def test_a_damaged_note_never_smuggles_bytes(place: int, value: int) -> None:
    note = bytearray(apple_note((0.1, -0.98, 0.1)))
    note[place] = value
    rebuilt = acceleration_note(bytes(note))
    assert len(rebuilt) in (0, 56)
    assert SECRET[:8] not in rebuilt
