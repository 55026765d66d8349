"""Inspect captures before their upload is accepted, while a phone waits: beside the jobs, a few at once."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import AsyncIterator
from contextlib import suppress
from pathlib import Path

import grpc

from capture2vr.edge.api import edge_pb2 as pb
from capture2vr.edge.arrays import Tick
from capture2vr.edge.errors import Cancelled
from capture2vr.edge.worker.failures import CANCELLED, failure_of
from capture2vr.edge.worker.job_request import RefusedError
from capture2vr.edge.worker.job_run import Work
from capture2vr.edge.worker.scratch import Scratch
from capture2vr.edge.worker.upload import receive
from capture2vr.order.photo_box import PhotoBox
from capture2vr.sentences.sentence import say

AT_ONCE = 4
"""Most inspections at once, each a process that mostly decodes headers: more would slow down the jobs, and a phone can
try again."""

WITHIN_S = 400.0
"""Timeout of reading a capture, in seconds of the clock: far more than the 220 s of a processor that it may take on a
machine that does other work too."""


class Inspections:
    """Inspects captures. Used on the event loop; each capture is read in a thread of its own."""

    def __init__(self, work: Work, scratch: Scratch) -> None:
        self._work = work
        self._scratch = scratch
        self._active = 0

    async def inspect(self, chunks: AsyncIterator[pb.Chunk], capture_bytes: int, box: PhotoBox | None) -> pb.Inspection:
        """Receive an archive and read it, with the rectangle in a single photo, if there is one.

        Raises RefusedError: RESOURCE_EXHAUSTED, DEADLINE_EXCEEDED, and as `receive`.
        """
        if self._active >= AT_ONCE:
            status = grpc.StatusCode.RESOURCE_EXHAUSTED
            raise RefusedError(status, "INSPECTIONS_BUSY", say("captures_being_inspected_already", count=AT_ONCE))
        folder = self._scratch.folder(capture_bytes)
        self._active += 1
        try:
            await receive(chunks, folder / "capture.zip", expected_bytes=capture_bytes)
        except BaseException:
            self._release(folder)
            raise
        return await self._read(folder, box)

    async def _read(self, folder: Path, box: PhotoBox | None) -> pb.Inspection:
        """Read the capture in a thread. Its end, not the caller's, releases the folder: when the caller hangs up, the
        thread is told, but may take a moment."""
        loop = asyncio.get_running_loop()
        verdict: asyncio.Future[pb.Inspection] = loop.create_future()
        abandoned = threading.Event()

        def tick(_: float) -> None:
            if abandoned.is_set():
                raise Cancelled

        def read() -> None:
            inspection = self._verdict(folder, box, tick)
            with suppress(RuntimeError):  # the loop is closed: the worker has shut down
                loop.call_soon_threadsafe(self._deliver, folder, verdict, inspection)

        threading.Thread(target=read, name="inspection", daemon=True).start()
        try:
            async with asyncio.timeout(WITHIN_S):
                return await verdict
        except TimeoutError:
            status = grpc.StatusCode.DEADLINE_EXCEEDED
            raise RefusedError(status, "INSPECTION_SLOW", say("capture_not_read_within_s", seconds=WITHIN_S)) from None
        finally:
            abandoned.set()

    def _verdict(self, folder: Path, box: PhotoBox | None, tick: Tick) -> pb.Inspection:
        scratch = folder / "work"
        try:
            scratch.mkdir()
            return self._work.inspect(folder / "capture.zip", scratch, box, tick)
        except Cancelled:
            return pb.Inspection(failure=CANCELLED)
        except BaseException as error:  # noqa: BLE001 - the caller must get an answer whatever happens here
            failure = failure_of(error, job="of an inspection", scratch=scratch)
            failure.stage = pb.VALIDATING
            return pb.Inspection(failure=failure)

    def _deliver(self, folder: Path, verdict: asyncio.Future[pb.Inspection], inspection: pb.Inspection) -> None:
        self._release(folder)
        if not verdict.done():
            verdict.set_result(inspection)

    def _release(self, folder: Path) -> None:
        self._active -= 1
        self._scratch.drop(folder)
