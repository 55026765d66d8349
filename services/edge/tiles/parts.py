"""Run one task for each of many parts of a scene: one after the other here, or side by side on an engine.

A part that fails is tried again, and the others go on meanwhile. What is finished is stored as it comes.
"""

from __future__ import annotations

import logging
from collections import Counter, deque
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import FIRST_COMPLETED, wait
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from capture2vr.edge.arrays import part_of
from capture2vr.edge.engine.nouns import Engine, Needs, Submitted, Work
from capture2vr.edge.errors import Cancelled, EdgeError
from capture2vr.edge.progress import Bar, Progress
from capture2vr.sentences.sentence import say

TRIES = 3
"""How often a part is tried before the job fails."""
PART_NEEDS = Needs(cpus=1, memory_bytes=1_300_000_000)
"""Of a tile of 256 cells a side (`grid.SIDE`): 0.9 to 1.2 GB were measured for rooms, interpreter included."""

_AHEAD = 8  # parts that are submitted at once; one's inputs take some 10 MB, and 100 MB where it has pictures
_POLL_S = 0.5  # between two looks whether the job was cancelled

_log = logging.getLogger(__name__)

Part = TypeVar("Part")
Result = TypeVar("Result")


@dataclass(frozen=True, slots=True)
class PartWork(Generic[Part, Result]):
    """What is done for each part.

    name      of a part, for messages
    is_made   whether the result of a part is stored already
    work      work(tick, *inputs) -> result, on any machine
    inputs    reads a part's inputs
    keep      stores a part's result
    """

    name: Callable[[Part], str]
    is_made: Callable[[Part], bool]
    work: Work[Result]
    inputs: Callable[[Part], tuple[Any, ...]]
    keep: Callable[[Part, Result], None]


def _tiles_done(done: int, total: int) -> str:
    return say("tiles_done", done=done, total=total)


@dataclass(frozen=True, slots=True)
class Span:
    """Where on the bar a series of parts is: `stage`, and from which to which share of it.

    count   says how many parts of how many are done
    """

    bar: Bar
    stage: str
    count: Callable[[int, int], str] = _tiles_done
    begin: float = 0.0
    end: float = 1.0

    def at(self, share: float) -> float:
        """Share of the stage at which `share` of the series is done."""
        return self.begin + share * (self.end - self.begin)

    def told(self, done: int, total: int) -> Progress:
        """Say how many parts are done."""
        return self.bar.advance(self.stage, self.at(done / total), self.count(done, total))


def run_parts(
    engine: Engine | None, parts: Sequence[Part], work: PartWork[Part, Result], span: Span
) -> Generator[Progress, None, None]:
    """Process every part that has no result yet, in parallel, and store the results as they come.

    engine  None: one after the other, in this process

    Raises EdgeError TILE_FAILED, which names the part, where one fails each time; ENGINE_LOST, TASK_LOST; and Cancelled
    as the bar does. The results that have come are kept.
    """
    pending = [part for part in parts if not work.is_made(part)]
    if pending:
        yield span.told(len(parts) - len(pending), len(parts))
    if engine is None:
        yield from _one_by_one(pending, len(parts), work, span)
    else:
        yield from _side_by_side(engine, pending, len(parts), work, span)


def part_failed(name: str, error: Exception) -> EdgeError:
    """Return the error of a part that has failed each time, the last time by `error`."""
    return EdgeError(
        "TILE_FAILED",
        say("tile_scene_failed_times", name=name, times=TRIES, why=str(error) or type(error).__name__),
        hints=(say("send_scene_without_part"), say("use_preset_scene_makes")),
    )


def _one_by_one(
    pending: Sequence[Part], total: int, work: PartWork[Part, Result], span: Span
) -> Generator[Progress, None, None]:
    tick = span.bar.tick(span.stage)
    for done, part in enumerate(pending, total - len(pending)):
        within = part_of(tick, span.at(done / total), span.at((done + 1) / total))
        failures = Counter[Part]()
        while not work.is_made(part):
            try:
                work.keep(part, work.work(within, *work.inputs(part)))
            except Cancelled:
                raise
            except Exception as error:  # noqa: BLE001 - a part may fail in any way; the others must not be lost with it
                _note_failure(part, error, failures, work)
        yield span.told(done + 1, total)


def _side_by_side(
    engine: Engine, pending: Sequence[Part], total: int, work: PartWork[Part, Result], span: Span
) -> Generator[Progress, None, None]:
    waiting, done, failures = deque(pending), total - len(pending), Counter[Part]()
    running: dict[Part, Submitted[Result]] = {}
    try:
        while waiting or running:
            while waiting and len(running) < _AHEAD:
                part = waiting.popleft()
                try:
                    running[part] = engine.submit(PART_NEEDS, work.work, *work.inputs(part))
                except EdgeError:
                    raise
                except Exception as error:  # noqa: BLE001 - as above: its inputs cannot be read
                    _note_failure(part, error, failures, work)
                    waiting.append(part)
            for part in _ended(running, span, done / total):
                try:
                    work.keep(part, running.pop(part).result(0))
                except EdgeError:
                    raise
                except Exception as error:  # noqa: BLE001 - as above
                    _note_failure(part, error, failures, work)
                    waiting.append(part)
                else:
                    done += 1
                    yield span.told(done, total)
    finally:
        for task in running.values():
            task.cancel()


def _ended(running: dict[Part, Submitted[Result]], span: Span, share: float) -> list[Part]:
    """Wait until some of the tasks have ended; return their parts. Meanwhile the bar may raise."""
    tick = span.bar.tick(span.stage)
    while running:
        tick(span.at(share))
        wait([task.future for task in running.values()], _POLL_S, FIRST_COMPLETED)
        if ended := [part for part, task in running.items() if task.future.done()]:
            return ended
    return []


def _note_failure(part: Part, error: Exception, failures: Counter[Part], work: PartWork[Part, Any]) -> None:
    """Count a failure. Raises EdgeError TILE_FAILED for the last one that is borne."""
    failures[part] += 1
    name = work.name(part)
    _log.warning("tile %s: attempt %d of %d failed: %s", name, failures[part], TRIES, error)
    if failures[part] == TRIES:
        raise part_failed(name, error) from error
