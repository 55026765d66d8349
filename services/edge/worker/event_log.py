"""Event log of one run of a job: subscribers get the events from any point on, first replayed, then live."""

from __future__ import annotations

import asyncio
import time
from collections import deque
from collections.abc import AsyncIterator

from capture2vr.edge.api import edge_pb2 as pb

Update = pb.Progress | pb.Published | pb.AnchorPoints
Ending = pb.Failure | pb.Finished

HEARTBEAT_S = 4.0
"""Seconds without an event after which a heartbeat is sent. The wire promises 5; 1 s is left for a busy interpreter
lock."""

_ETA_FROM = 0.05
"""Fraction of the job below which the time left is not estimated."""

_RECENT_S = 15.0
_RECENT_FROM_S = 3.0
"""Most and least seconds of recent progress from which the time left is estimated. A fit that resumes from a checkpoint
jumps ahead once; the rate of the whole run would then promise an end within moments."""


class EventLog:
    """Events 1, 2, 3, ... up to one `Failure` or `Finished`. Used on the event loop only; not thread-safe."""

    def __init__(self, job: str) -> None:
        self._job = job
        self._began = time.monotonic()
        self._work_began = self._began
        self._events: list[pb.Event] = []
        self._appended = asyncio.Event()
        self._fraction = 0.0
        self._recent: deque[tuple[float, float]] = deque()
        self._stage = pb.STAGE_UNSPECIFIED
        self._ending: Ending | None = None

    @property
    def ending(self) -> Ending | None:
        """The terminal event; None while the run lives."""
        return self._ending

    def start_clock(self) -> None:
        """Start the time from which the time left is estimated: the run has left the queue."""
        self._work_began = time.monotonic()

    def add(self, update: Update) -> None:
        """Append an event. A fraction that is lower than the last, above 1 or NaN is replaced by the last."""
        match update:
            case pb.Progress():
                self._append(progress=self._completed(update))
            case pb.Published():
                self._append(published=update)
            case pb.AnchorPoints():
                self._append(anchors=update)

    def end(self, ending: Ending) -> None:
        """Append the terminal event; a failure without a stage gets the stage of the last progress."""
        self._ending = ending
        match ending:
            case pb.Failure():
                self._append(failure=_with_stage(ending, self._stage))
            case pb.Finished():
                self._append(finished=ending)

    @property
    def stage(self) -> pb.Stage:
        """The stage of the last progress."""
        return self._stage

    @property
    def last_seq(self) -> int:
        """The number of the last event; 0 before the first."""
        return len(self._events)

    async def follow(self, after_seq: int = 0) -> AsyncIterator[pb.Event]:
        """Yield the events after `after_seq` up to the terminal one. There may be any number of subscribers; a slow one
        does not delay the others."""
        while True:
            for event in self._events[after_seq:]:
                yield event
                after_seq = event.seq
            if after_seq < len(self._events):
                continue
            if self._ending is not None:
                return
            await self._appended.wait()

    async def send_heartbeats(self, every_s: float = HEARTBEAT_S) -> None:
        """Append a heartbeat whenever there was no event for `every_s`, until the run ends."""
        while self._ending is None:
            try:
                async with asyncio.timeout(every_s):
                    await self._appended.wait()
            except TimeoutError:
                self._append(heartbeat=pb.Heartbeat())

    def _completed(self, progress: pb.Progress) -> pb.Progress:
        """A copy whose fraction never goes back, with the estimated time left."""
        if self._fraction < progress.fraction <= 1.0:
            self._fraction = progress.fraction
        self._stage = progress.stage
        completed = pb.Progress()
        completed.CopyFrom(progress)
        completed.fraction = self._fraction
        if not progress.eta_s and self._fraction >= _ETA_FROM:
            completed.eta_s = self._remaining_s(time.monotonic())
        return completed

    def _remaining_s(self, now: float) -> float:
        """Estimated seconds left: at the recent rate where there was recent progress, else at the whole run's."""
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
        anchors: pb.AnchorPoints | None = None,
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
                anchors=anchors,
                heartbeat=heartbeat,
                failure=failure,
                finished=finished,
            )
        )
        # Wake the subscribers that wait on the old asyncio.Event; later ones wait on the new.
        self._appended.set()
        self._appended = asyncio.Event()


def _with_stage(failure: pb.Failure, stage: pb.Stage) -> pb.Failure:
    staged = pb.Failure()
    staged.CopyFrom(failure)
    staged.stage = failure.stage or stage
    return staged
