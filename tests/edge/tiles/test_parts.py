"""Parts of a scene, here and side by side: each result is stored once; a failure is tried again, and named at last."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from capture2vr.edge.engine.address import open_engine
from capture2vr.edge.engine.nouns import Engine, Needs
from capture2vr.edge.errors import Cancelled, EdgeError
from capture2vr.edge.progress import Bar, Progress, Watch, ignore_progress
from capture2vr.edge.tiles.parts import TRIES, PartWork, Span, run_parts
from tests.support.workers import engine_tasks

PLACES = ("here", "side by side")


@contextmanager
def engine_at(place: str) -> Iterator[Engine | None]:
    if place == "here":
        yield None
        return
    with open_engine("local", Needs(2, 0, 4 << 30)) as engine:
        yield engine


class Parts:
    """Numbers that are doubled. unreadable: how often the inputs of each fail"""

    def __init__(self, made: dict[int, int] | None = None, unreadable: dict[int, int] | None = None) -> None:
        self.made = made or {}
        self.kept = Counter[int]()
        self._unreadable = Counter(unreadable or {})

    def run(self, place: str, count: int, watch: Watch = ignore_progress) -> list[Progress]:
        bar = Bar(watch)
        bar.set_range({"EXTRACTING": 0.0}, 0.0, 1.0)
        work = PartWork(str, self.made.__contains__, engine_tasks.double, self._inputs, self._keep)
        with engine_at(place) as engine:
            return list(run_parts(engine, range(count), work, Span(bar, "EXTRACTING", begin=0.5)))

    def _inputs(self, part: int) -> tuple[int]:
        if self._unreadable[part]:
            self._unreadable[part] -= 1
            raise MemoryError
        return (part,)

    def _keep(self, part: int, result: int) -> None:
        self.made[part] = result
        self.kept[part] += 1


@pytest.mark.parametrize("place", PLACES)
def test_every_result_is_stored_once(place: str) -> None:
    """One was made before; one fails all but the last time."""
    parts = Parts({1: 2}, {2: TRIES - 1})
    said = parts.run(place, 4)
    assert parts.made == {0: 0, 1: 2, 2: 4, 3: 6}
    assert parts.kept == {0: 1, 2: 1, 3: 1}
    assert [step.message for step in said] == [f"{done} of 4 tiles" for done in (1, 2, 3, 4)]
    fractions = [step.fraction for step in said]
    assert fractions == sorted(fractions)
    assert (fractions[0], fractions[-1]) == (0.625, 1.0)


@pytest.mark.parametrize("place", PLACES)
def test_a_part_that_always_fails_is_named(place: str) -> None:
    parts = Parts(unreadable={1: TRIES})
    with pytest.raises(EdgeError, match=f"tile 1 of the scene failed {TRIES} times: MemoryError") as raised:
        parts.run(place, 3)
    assert raised.value.code == "TILE_FAILED"
    assert set(parts.made) <= {0, 2}, "what was finished stays"


@pytest.mark.parametrize("place", PLACES)
def test_who_cancels_stops_it(place: str) -> None:
    def stop(progress: Progress) -> None:
        raise Cancelled

    parts = Parts()
    with pytest.raises(Cancelled):
        parts.run(place, 3, stop)
    assert len(parts.made) < 3


@pytest.mark.parametrize("place", PLACES)
def test_no_parts_are_no_work(place: str) -> None:
    assert Parts({0: 0}).run(place, 1) == []
