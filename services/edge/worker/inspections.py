"""Read captures on behalf of phones that still wait for their upload's verdict: beside the jobs, but few at once."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import AsyncIterator
from contextlib import suppress
from pathlib import Path

import grpc

from services.edge.api import edge_pb2 as pb
from services.edge.failures import failure_of
from services.edge.requests import RefusedError
from services.edge.run import Work
from services.edge.scratch import Scratch
from services.edge.upload import receive

AT_ONCE = 4
"""Inspections at once, each a thread that mostly decodes headers; a phone can ask again, a job would be slowed down."""

WITHIN_S = 120.0
"""Seconds after which a verdict is of no use: the phone's request has timed out long before."""


class Inspections:
    """Verdicts on captures. Lives on the event loop; the reading has threads of its own."""

    def __init__(self, work: Work, scratch: Scratch) -> None:
        self._work = work
        self._scratch = scratch
        self._reading = 0

    async def inspect(self, chunks: AsyncIterator[pb.Chunk], capture_bytes: int) -> pb.Inspection:
        """Receive an archive and read it. Raises RefusedError: RESOURCE_EXHAUSTED, DEADLINE_EXCEEDED, `receive`'s."""
        if self._reading >= AT_ONCE:
            status = grpc.StatusCode.RESOURCE_EXHAUSTED
            raise RefusedError(status, "INSPECTIONS_BUSY", f"{AT_ONCE} captures are being inspected already")
        folder = self._scratch.folder(capture_bytes)
        self._reading += 1
        try:
            await receive(chunks, folder / "capture.zip", expected_bytes=capture_bytes)
        except BaseException:
            self._left(folder)
            raise
        return await self._read(folder)

    async def _read(self, folder: Path) -> pb.Inspection:
        """The thread, not the caller, leaves the folder: a caller may go while a file is still being read."""
        loop = asyncio.get_running_loop()
        verdict: asyncio.Future[pb.Inspection] = loop.create_future()

        def read() -> None:
            inspection = self._verdict(folder)
            with suppress(RuntimeError):  # the loop is closed: the worker has left
                loop.call_soon_threadsafe(self._tell, folder, verdict, inspection)

        threading.Thread(target=read, name="inspection", daemon=True).start()
        try:
            async with asyncio.timeout(WITHIN_S):
                return await verdict
        except TimeoutError:
            status = grpc.StatusCode.DEADLINE_EXCEEDED
            raise RefusedError(status, "INSPECTION_SLOW", f"the capture was not read within {WITHIN_S:.0f} s") from None

    def _verdict(self, folder: Path) -> pb.Inspection:
        scratch = folder / "work"
        try:
            scratch.mkdir()
            return self._work.inspect(folder / "capture.zip", scratch)
        except BaseException as error:  # noqa: BLE001 - the caller waits for an answer whatever happens here
            failure = failure_of(error, job="of an inspection", scratch=scratch)
            failure.stage = pb.VALIDATING
            return pb.Inspection(failure=failure)

    def _tell(self, folder: Path, verdict: asyncio.Future[pb.Inspection], inspection: pb.Inspection) -> None:
        self._left(folder)
        if not verdict.done():
            verdict.set_result(inspection)

    def _left(self, folder: Path) -> None:
        self._reading -= 1
        self._scratch.drop(folder)
