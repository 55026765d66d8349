"""Small parts of an upload are joined: its objects stay few, and its bytes are written a few times at most."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from capture2vr.gateway.resumable.chunk_objects import small_tail
from capture2vr.gateway.resumable.store import Chunk

_LEAST = 1 << 22  # bytes of a large chunk
_SIZES = st.one_of(st.integers(1, 3), st.integers(1, 10_000), st.integers(1, 3 * _LEAST))


def after(sizes: list[int]) -> tuple[list[Chunk], int]:
    """The chunks of an upload whose requests have these sizes, and how many bytes were written in all."""
    chunks: list[Chunk] = []
    end = written = 0
    for size in sizes:
        tail = small_tail(chunks, size, _LEAST)
        chunks = chunks[: len(chunks) - len(tail)]
        start = tail[0].start if tail else end
        end += size
        chunks.append(Chunk(start, end - start, ""))
        written += end - start
    return chunks, written


def assert_few(sizes: list[int]) -> None:
    chunks, written = after(sizes)
    ends = [0, *(chunk.start + chunk.length for chunk in chunks)]
    assert [chunk.start for chunk in chunks] == ends[:-1]
    assert ends[-1] == sum(sizes)
    assert len(chunks) <= sum(sizes) / _LEAST + math.log2(_LEAST) + 1
    assert written <= (math.log(_LEAST, 1.5) + 1) * sum(sizes)


@given(st.lists(_SIZES, max_size=200))
def test_whatever_the_sizes_the_objects_are_few(sizes: list[int]) -> None:
    assert_few(sizes)


@pytest.mark.parametrize(
    "sizes", [[1] * 5_000, [*range(3_000, 0, -1)], [*range(1, 3_000)], [1, _LEAST - 1] * 50, [2 * _LEAST] * 50]
)
def test_sizes_that_somebody_chose_to_be_many_objects(sizes: list[int]) -> None:
    assert_few(sizes)
