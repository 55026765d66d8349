"""How far a job is: stages on one bar that never goes back, and the seconds that each of them takes."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from services.edge.arrays import Tick


@dataclass(frozen=True, slots=True)
class Progress:
    """How far the whole job is: `fraction` in [0,1] never goes back; `losses` while a field is trained."""

    stage: str
    fraction: float
    message: str = ""
    losses: Mapping[str, float] = field(default_factory=dict)


Watch = Callable[[Progress], None]
"""Hears of progress inside a stage; may raise `Cancelled`, which stops the work between two slabs."""


def unwatched(progress: Progress) -> None:
    """The watch of a caller who does not look."""


class Bar:
    """The bar of a job that goes through its stages in passes, each on its own part of the bar."""

    def __init__(self, watch: Watch) -> None:
        self._watch = watch
        self._reached = 0.0

    @property
    def reached(self) -> float:
        """How far it is, in [0,1]."""
        return self._reached

    def covers(self, starts: Mapping[str, float], begin: float, end: float) -> None:
        """From now on stages begin where `starts` says, in [0,1] of the bar's part from `begin` to `end`."""
        self._starts, self._begin, self._end = starts, begin, end

    def at(self, stage: str, part: float, message: str = "", losses: Mapping[str, float] | None = None) -> Progress:
        """That part of a stage is done, in [0,1]. What is repeated, after a step down say, stands still until then."""
        start = self._starts[stage]
        following = min((each for each in self._starts.values() if each > start), default=1.0)
        within = start + (following - start) * float(np.clip(part, 0.0, 1.0))
        self._reached = max(self._reached, self._begin + (self._end - self._begin) * within)
        return Progress(stage, self._reached, message, losses or {})

    def starts(self, stage: str, message: str) -> Progress:
        """A stage begins."""
        return self.at(stage, 0.0, message)

    def inside(self, stage: str) -> Tick:
        """A tick that maps a stage's own fraction onto the job's, and tells whoever watches."""
        return lambda part: self._watch(self.at(stage, part))


class Clock:
    """Seconds per stage: `with clock("FITTING"): ...` adds to `clock.seconds["FITTING"]`."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    def __call__(self, stage: str) -> Clock:
        self._stage = stage
        return self

    def __enter__(self) -> None:
        self._began = time.perf_counter()

    def __exit__(self, *exc: object) -> None:
        spent = time.perf_counter() - self._began
        self.seconds[self._stage] = round(self.seconds.get(self._stage, 0.0) + spent, 3)
