"""What one run of a job has said so far, and whoever listens: replayed from any point, then live."""

from __future__ import annotations

import asyncio
import time
from collections import deque
from collections.abc import AsyncIterator

from services.edge.api import edge_pb2 as pb

Said = pb.Progress | pb.Published
Ending = pb.Failure | pb.Finished

HEARTBEAT_S = 4.0
"""Seconds of silence after which a heartbeat is said. The wire promises 5; one is left for a busy interpreter lock."""

_ETA_FROM = 0.05
"""Fraction below which elapsed / fraction says nothing yet about the time left."""

_RECENT_S = 15.0
_RECENT_FROM_S = 3.0
"""Seconds of progress whose rate tells the time left, at most and at least. A fit that goes on from a checkpoint jumps
ahead once, and the rate of the whole run would promise its end within moments."""


class EventLog:
    """Events 1, 2, 3, ... up to one `Failure` or `Finished`. Lives on the event loop; nothing here is thread-safe."""

    def __init__(self, job: str) -> None:
        self._job = job
        self._began = time.monotonic()
        self._work_began = self._began
        self._events: list[pb.Event] = []
        self._news = asyncio.Event()
        self._fraction = 0.0
        self._recent: deque[tuple[float, float]] = deque()
        self._stage = pb.STAGE_UNSPECIFIED
        self._ending: Ending | None = None

    @property
    def ending(self) -> Ending | None:
        """How the run ended; None while it lives."""
        return self._ending

    def work_begins(self) -> None:
        """The run leaves the queue: time left is reckoned from here."""
        self._work_began = time.monotonic()

    def say(self, what: Said) -> None:
        """Append an event. A fraction that is lower than the last, above 1 or no number is replaced by the last."""
        match what:
            case pb.Progress():
                self._append(progress=self._progress(what))
            case pb.Published():
                self._append(published=what)

    def end(self, ending: Ending) -> None:
        """Append the terminal event; a failure without a stage gets the stage last heard of."""
        self._ending = ending
        match ending:
            case pb.Failure():
                self._append(failure=_with_stage(ending, self._stage))
            case pb.Finished():
                self._append(finished=ending)

    @property
    def last_seq(self) -> int:
        """The number of the last event; 0 before the first."""
        return len(self._events)

    async def follow(self, after_seq: int = 0) -> AsyncIterator[pb.Event]:
        """The events after `after_seq` through the terminal one. Any number of followers, none holds up another."""
        while True:
            for event in self._events[after_seq:]:
                yield event
                after_seq = event.seq
            if after_seq < len(self._events):
                continue
            if self._ending is not None:
                return
            await self._news.wait()

    async def beat(self, every_s: float = HEARTBEAT_S) -> None:
        """Say a heartbeat whenever nothing else was said for `every_s`, till the end."""
        while self._ending is None:
            try:
                async with asyncio.timeout(every_s):
                    await self._news.wait()
            except TimeoutError:
                self._append(heartbeat=pb.Heartbeat())

    def _progress(self, told: pb.Progress) -> pb.Progress:
        if self._fraction < told.fraction <= 1.0:
            self._fraction = told.fraction
        self._stage = told.stage
        progress = pb.Progress()
        progress.CopyFrom(told)
        progress.fraction = self._fraction
        if not told.eta_s and self._fraction >= _ETA_FROM:
            progress.eta_s = self._left_s(time.monotonic())
        return progress

    def _left_s(self, now: float) -> float:
        """Seconds left, at the recent rate where there is any progress, else at that of the whole run."""
        self._recent.append((now, self._fraction))
        while now - self._recent[0][0] > _RECENT_S and len(self._recent) > 1:
            self._recent.popleft()
        since, fraction = self._recent[0]
        if now - since >= _RECENT_FROM_S and self._fraction > fraction:
            return (now - since) * (1.0 - self._fraction) / (self._fraction - fraction)
        return (now - self._work_began) * (1.0 - self._fraction) / self._fraction

    def _append(
        self,
        *,
        progress: pb.Progress | None = None,
        published: pb.Published | None = None,
        heartbeat: pb.Heartbeat | None = None,
        failure: pb.Failure | None = None,
        finished: pb.Finished | None = None,
    ) -> None:
        self._events.append(
            pb.Event(
                job=self._job,
                seq=len(self._events) + 1,
                elapsed_s=time.monotonic() - self._began,
                progress=progress,
                published=published,
                heartbeat=heartbeat,
                failure=failure,
                finished=finished,
            )
        )
        # Whoever waits holds the old Event; whoever comes next waits for the next news.
        self._news.set()
        self._news = asyncio.Event()


def _with_stage(failure: pb.Failure, stage: pb.Stage) -> pb.Failure:
    staged = pb.Failure()
    staged.CopyFrom(failure)
    staged.stage = failure.stage or stage
    return staged
