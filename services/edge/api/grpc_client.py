"""gRPC client of a worker: get its state, upload an archive, stream a run's events, reconnect to a lost run.

The gateway calls workers with it, and a worker calls its central worker. A client has one channel, and belongs to one
event loop.
"""

from __future__ import annotations

import asyncio
import hashlib
import logging
import time
from collections.abc import AsyncGenerator, Callable
from contextlib import aclosing
from pathlib import Path
from typing import Any

import grpc

from capture2vr.edge.api import edge_pb2 as pb
from capture2vr.edge.api import edge_pb2_grpc
from capture2vr.process.grpc_security import NO_CREDENTIALS, ClientCredentials

_log = logging.getLogger(__name__)

CHUNK_BYTES = 512 << 10
"""Bytes of an archive per message; the wire asks for 256 KiB to 1 MiB."""

MESSAGE_BYTES = 8 << 20
"""Largest message either way: eight of the wire's largest chunks."""

KEEPALIVE = (
    # A phone's hotspot drops silent connections after about 30 s: ping before, and notice a dead peer within 10 s.
    ("grpc.keepalive_time_ms", 20_000),
    ("grpc.keepalive_timeout_ms", 10_000),
)

MESSAGE_LIMITS = (
    ("grpc.max_receive_message_length", MESSAGE_BYTES),
    ("grpc.max_send_message_length", MESSAGE_BYTES),
)

_CHANNEL_OPTIONS = (
    *MESSAGE_LIMITS,
    *KEEPALIVE,
    # A worker that restarts is back within seconds; gRPC's own pauses grow to two minutes.
    ("grpc.initial_reconnect_backoff_ms", 200),
    ("grpc.min_reconnect_backoff_ms", 500),
    ("grpc.max_reconnect_backoff_ms", 1_000),
)

SILENCE_S = 15.0
"""Seconds without a message after which a stream counts as dead: three heartbeats were missed."""

RUN_S = 6 * 3600.0
"""Deadline of the call that starts a run, in seconds; what still runs then is followed on."""

# Exponential backoff between attempts to attach to a lost run: a worker that restarts needs a second or two.
_FIRST_PAUSE_S = 0.1
_LAST_PAUSE_S = 2.0
_BACKOFF = 1.5  # factor from one pause to the next

RUN_UNKNOWN = frozenset({grpc.StatusCode.NOT_FOUND, grpc.StatusCode.OUT_OF_RANGE})
"""Statuses of a worker that does not know the run, or has sent fewer of its events: it was restarted."""


class StreamEnded(Exception):  # noqa: N818 - not always an error: a worker that restarts is found again
    """A stream of events ended before its run did.

    status     gRPC's, or None where the stream merely stopped
    delivered  whether the whole archive had been sent: from there on the worker may have taken the job
    The text is the worker's own, "CODE: sentence", where it refused the call.
    """

    def __init__(self, status: grpc.StatusCode | None, details: str) -> None:
        super().__init__(details)
        self.status = status
        self.delivered = False


class GrpcClient:
    """Client of the worker at `address`. Methods raise grpc.aio.AioRpcError where their docstrings name no other."""

    def __init__(
        self,
        address: str,
        credentials: ClientCredentials = NO_CREDENTIALS,
        *,
        name: str = "",
        silence_s: float = SILENCE_S,
        run_s: float = RUN_S,
    ) -> None:
        """silence_s: longest time between two messages of a stream; run_s: deadline of a whole run.

        name  what the worker's certificate must be for, where that is not the host of `address`
        """
        self.address = address
        self._silence_s = silence_s
        self._run_s = run_s
        named = (("grpc.ssl_target_name_override", name),) if name else ()
        self._channel = credentials.aio_channel(address, (*_CHANNEL_OPTIONS, *named))
        self._stub: Any = edge_pb2_grpc.EdgeReconstructionStub(self._channel)  # type: ignore[no-untyped-call]

    async def worker(self, timeout_s: float, *, wait_for_ready: bool = False) -> pb.Worker:
        """Return the worker's state and the presets that it offers.

        wait_for_ready  whether to wait while the connection is being made. Otherwise a channel that has just failed
                        fails every call of the next second, without another attempt to connect
        """
        request = pb.GetWorkerRequest()
        answer: pb.Worker = await self._stub.GetWorker(request, timeout=timeout_s, wait_for_ready=wait_for_ready)
        return answer

    async def make_room(self, job: str, token: str, timeout_s: float) -> bool:
        """Have a run yield its slot to others, if it can go on from a checkpoint later. Return whether it does."""
        reply = await self._stub.Yield(pb.YieldRequest(job=job, token=token), timeout=timeout_s)
        return bool(reply.yields)

    async def cancel(self, job: str, token: str, timeout_s: float, *, wait_for_ready: bool = False) -> bool:
        """Stop a run. Return whether it was running. token: the job's, from its header"""
        request = pb.CancelRequest(job=job, token=token)
        reply = await self._stub.Cancel(request, timeout=timeout_s, wait_for_ready=wait_for_ready)
        return bool(reply.was_running)

    async def inspect(self, header: pb.Header, data: AsyncGenerator[bytes, None], timeout_s: float) -> pb.Inspection:
        """Upload a capture and return the worker's verdict on it."""
        call = self._stub.Inspect(timeout=timeout_s)
        sending = asyncio.create_task(_Upload(call, header, data, _SilenceLimit(timeout_s)).send())
        try:
            answer: pb.Inspection = await call
        finally:
            sending.cancel()
            call.cancel()
            await asyncio.wait([sending])
        return answer

    async def make_download(self, request: pb.DownloadRequest, timeout_s: float) -> pb.Download:
        """Have the worker convert a published asset, and return the file's name on the store."""
        answer: pb.Download = await self._stub.MakeDownload(request, timeout=timeout_s)
        return answer

    async def reconstruct(
        self, header: pb.Header, data: AsyncGenerator[bytes, None], *, admit_s: float | None = None
    ) -> AsyncGenerator[pb.Event, None]:
        """Upload a job with its archive, then yield its events up to a `Failure` or `Finished`.

        admit_s  longest time for the worker to admit the job by its header, before any data is sent; None: `silence_s`
        Raises StreamEnded, and whatever reading `data` raises.
        """
        call = self._stub.Reconstruct(timeout=self._run_s)
        silence = _SilenceLimit(self._silence_s, first_s=admit_s)
        upload = _Upload(call, header, data, silence)
        sending = asyncio.create_task(upload.send())
        try:
            async with aclosing(_events(call, silence)) as events:
                async for event in events:
                    yield event
        except StreamEnded as ended:
            # When reading `data` failed here, the worker complains about a broken upload: report the cause instead.
            if sending.done() and not sending.cancelled() and (error := sending.exception()):
                raise error from None
            ended.delivered = upload.delivered
            raise
        finally:
            sending.cancel()
            call.cancel()
            await asyncio.wait([sending])

    async def attach(self, job: str, token: str, after_seq: int) -> AsyncGenerator[pb.Event, None]:
        """Yield the events of a run after `after_seq`, up to a `Failure` or `Finished`. Raises StreamEnded.

        token  the job's, from its header
        """
        request = pb.AttachRequest(job=job, token=token, after_seq=after_seq)
        call = self._stub.Attach(request, timeout=self._run_s)
        try:
            async with aclosing(_events(call, _SilenceLimit(self._silence_s))) as events:
                async for event in events:
                    yield event
        finally:
            call.cancel()

    async def follow(
        self, job: str, token: str, after_seq: int, *, give_up_s: float, lost: Callable[[], None] = lambda: None
    ) -> AsyncGenerator[pb.Event, None]:
        """Yield a run's events as `attach` does, and reconnect after the last event whenever the stream breaks.

        lost  called whenever the stream has broken
        Raises StreamEnded where the worker does not know the run (RUN_UNKNOWN), and where no event of it arrived for
        `give_up_s` seconds after the stream broke, or from the beginning.
        """
        pause_s, lost_since = _FIRST_PAUSE_S, time.monotonic()
        while True:
            heard = False
            try:
                async with aclosing(self.attach(job, token, after_seq)) as events:
                    async for event in events:
                        after_seq, pause_s, heard = event.seq, _FIRST_PAUSE_S, True
                        yield event
                return
            except StreamEnded as ended:
                # Not since the last event: it takes `silence_s` to notice that a stream is dead, which may be longer.
                lost_since = time.monotonic() if heard else lost_since
                if ended.status in RUN_UNKNOWN or time.monotonic() - lost_since >= give_up_s:
                    raise
                level = logging.WARNING if pause_s == _FIRST_PAUSE_S else logging.DEBUG  # once for every loss
                _log.log(level, "job %s: lost the connection to %s (%s), reconnecting", job, self.address, ended)
                lost()
            await asyncio.sleep(pause_s)
            pause_s = min(_LAST_PAUSE_S, _BACKOFF * pause_s)

    async def close(self) -> None:
        """Close the channel; open streams end."""
        await self._channel.close()


async def file_chunks(path: Path) -> AsyncGenerator[bytes, None]:
    """Yield the bytes of a file in chunks, read in a thread so that the event loop is not blocked."""
    with path.open("rb") as file:
        while block := await asyncio.to_thread(file.read, CHUNK_BYTES):
            yield block


class _SilenceLimit:
    """Timeout for a stream without messages; every chunk of an upload that is sent resets it."""

    def __init__(self, seconds: float, *, first_s: float | None = None) -> None:
        self.seconds = seconds if first_s is None else first_s
        self._later_s = seconds
        self.limit: asyncio.Timeout | None = None

    def reset(self) -> None:
        """Restart the timer: a message or an acknowledged chunk has passed."""
        self.seconds = self._later_s
        if self.limit is not None and not self.limit.expired():
            self.limit.reschedule(asyncio.get_running_loop().time() + self.seconds)


class _Upload:
    """Sends header, data and trailer. When `data` raises, no trailer is sent; when the worker ends the call, `send`
    returns, and the call's status says why."""

    def __init__(self, call: Any, header: pb.Header, data: AsyncGenerator[bytes, None], silence: _SilenceLimit) -> None:
        self.delivered = False
        self._call, self._header, self._data, self._silence = call, header, data, silence

    async def send(self) -> None:
        digest = hashlib.sha256()
        offset = 0
        try:
            await self._call.write(pb.Chunk(header=self._header))
            # Initial metadata means that the upload is admitted. Writing before it could turn a refusal into INTERNAL.
            await self._call.initial_metadata()
            self._silence.reset()
            try:
                async with aclosing(self._data):
                    async for block in self._data:
                        digest.update(block)
                        await self._call.write(pb.Chunk(data=pb.Data(offset=offset, data=block)))
                        offset += len(block)
                        self._silence.reset()
                self.delivered = True  # before it is sent: from here on the job may have been taken
                await self._call.write(pb.Chunk(trailer=pb.Trailer(sha256=digest.digest())))
            finally:
                await self._call.done_writing()
        except (grpc.aio.AioRpcError, asyncio.InvalidStateError):
            return


async def _events(call: Any, silence: _SilenceLimit) -> AsyncGenerator[pb.Event, None]:
    """Yield a call's events up to a `Failure` or `Finished`. Raises StreamEnded where the stream ends or is silent."""
    while True:
        try:
            async with asyncio.timeout(silence.seconds) as silence.limit:
                event = await call.read()
        except grpc.aio.AioRpcError as error:
            raise StreamEnded(error.code(), error.details() or error.code().name) from None
        except TimeoutError:
            raise StreamEnded(None, f"no message for {silence.seconds:g} s") from None
        if event is grpc.aio.EOF:
            raise StreamEnded(None, "the stream ended before the run did")
        yield event
        if event.WhichOneof("what") in ("failure", "finished"):
            return
