from __future__ import annotations

import threading
from collections.abc import Sequence

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from capture2vr.edge.errors import Cancelled
from capture2vr.edge.parallel import in_threads, one_ahead, shared_ticks


@given(st.lists(st.lists(st.floats(0, 1), max_size=5), min_size=1, max_size=4))
def test_shared_ticks_report_the_mean(reports: Sequence[Sequence[float]]) -> None:
    told: list[float] = []
    ticks = shared_ticks(told.append, len(reports))
    last = [0.0] * len(reports)
    for number, parts in enumerate(reports):
        for part in parts:
            ticks[number](part)
            last[number] = part
            assert told[-1] == pytest.approx(sum(last) / len(last))


def test_shared_ticks_all_raise_what_one_raised() -> None:
    def cancel(fraction: float) -> None:
        calls.append(fraction)
        raise Cancelled

    calls: list[float] = []
    first, second = shared_ticks(cancel, 2)
    for tick in (first, second, first):
        with pytest.raises(Cancelled):
            tick(0.5)
    assert len(calls) == 1


def test_a_cancelled_part_ends_the_others() -> None:
    started = threading.Barrier(2, timeout=20)

    def work(number: int) -> None:
        started.wait()  # both run at the same time
        while True:
            ticks[number](0.1)

    def cancel(fraction: float) -> None:
        raise Cancelled

    ticks = shared_ticks(cancel, 2)
    with pytest.raises(Cancelled):
        in_threads(work, range(2))


@settings(deadline=None)
@given(st.lists(st.integers(), max_size=20))
def test_one_ahead_keeps_the_order(parts: list[int]) -> None:
    assert list(one_ahead(lambda part: part * 2, parts)) == [part * 2 for part in parts]


def test_one_ahead_works_on_the_next_part_and_on_no_more() -> None:
    begun: list[int] = []
    next_begun = threading.Event()

    def work(part: int) -> int:
        begun.append(part)
        if part == 1:
            next_begun.set()
        return part

    results = one_ahead(work, range(9))
    assert next(results) == 0
    assert next_begun.wait(20)  # while the caller has the first
    results.close()  # type: ignore[attr-defined]
    assert begun == [0, 1]


def test_one_ahead_raises_at_the_part_that_failed() -> None:
    def work(part: int) -> int:
        if part == 2:
            raise ValueError("part 2")
        return part

    results = one_ahead(work, range(5))
    assert [next(results), next(results)] == [0, 1]
    with pytest.raises(ValueError, match="part 2"):
        next(results)
