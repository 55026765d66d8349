"""Progress of a job: its stages on one bar that never goes back, and the seconds that each stage takes."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from capture2vr.edge.arrays import Tick


@dataclass(frozen=True, slots=True)
class Progress:
    """One progress report: stage, `fraction` of the whole job in [0,1], and `losses` while a field is trained."""

    stage: str
    fraction: float
    message: str = ""
    losses: Mapping[str, float] = field(default_factory=dict)


Watch = Callable[[Progress], None]
"""Callback for progress inside a stage; may raise `Cancelled`, which stops the work at the next tick."""


def ignore_progress(progress: Progress) -> None:
    """Do nothing: the `Watch` of a caller that does not show progress."""


class Bar:
    """Progress bar of a job. The job runs through its stages in passes, each on its own part of the bar."""

    def __init__(self, watch: Watch) -> None:
        self._watch = watch
        self._reached = 0.0

    @property
    def reached(self) -> float:
        """Fraction of the whole bar reached so far, in [0,1]."""
        return self._reached

    def set_range(self, starts: Mapping[str, float], begin: float, end: float) -> None:
        """Begin a pass on the part of the bar from `begin` to `end`.

        starts  fraction of that part, in [0,1], at which each stage begins
        """
        self._starts, self._begin, self._end = starts, begin, end

    def advance(
        self, stage: str, part: float, message: str = "", losses: Mapping[str, float] | None = None
    ) -> Progress:
        """Report that `part` of a stage, in [0,1], is done. The bar stands still while work is repeated."""
        start = self._starts[stage]
        following = min((each for each in self._starts.values() if each > start), default=1.0)
        within = start + (following - start) * float(np.clip(part, 0.0, 1.0))
        self._reached = max(self._reached, self._begin + (self._end - self._begin) * within)
        return Progress(stage, self._reached, message, losses or {})

    def begin(self, stage: str, message: str) -> Progress:
        """Report that a stage begins."""
        return self.advance(stage, 0.0, message)

    def tick(self, stage: str) -> Tick:
        """Return a tick that maps a stage's own fraction to the job's, and reports it to the watch."""
        return lambda part: self._watch(self.advance(stage, part))


class Clock:
    """Stopwatch of the stages: `with clock("FITTING"): ...` adds its seconds to `clock.seconds["FITTING"]`."""

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
