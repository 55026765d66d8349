"""The only place that speaks gRPC: workers in, the gateway's own words out.

A call ends with an answer, an exception of workers.py, or a `Problem` that no other worker would solve.
"""

from __future__ import annotations

import asyncio
import hashlib
import logging
from collections.abc import AsyncGenerator, AsyncIterator, Callable, Sequence
from contextlib import aclosing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import grpc

from services.edge.api import edge_pb2 as pb
from services.edge.api import edge_pb2_grpc
from services.gateway.errors import Problem
from services.gateway.jobs.job import Job
from services.gateway.jobs.reports import Beat, Failed, Finished, Progressed, Published, Report
from services.gateway.jobs.transitions import problem_of
from services.gateway.workers import (
    Preset,
    RunKnown,
    RunUnknown,
    WorkerBusy,
    WorkerLost,
    WorkerStatus,
    WorkerUnreachable,
)
from services.link import PLAIN, Caller

_log = logging.getLogger(__name__)

CHUNK_BYTES = 512 << 10  # the wire asks for 256 KiB to 1 MiB
POLL_S = 1.0  # deadline of a question about a worker's state: one that needs longer is as good as absent
INSPECT_S = 120.0  # deadline of an inspection: uploading 1 GB within a data centre and reading its headers
CANCEL_S = 2.0  # deadline of a cancellation; it is repeated until the run ends

_OPTIONS = (
    ("grpc.max_receive_message_length", 8 << 20),
    ("grpc.max_send_message_length", 8 << 20),
    ("grpc.keepalive_time_ms", 20_000),
    ("grpc.keepalive_timeout_ms", 10_000),
    # A worker that restarts is back within seconds; gRPC's own pauses grow to two minutes.
    ("grpc.initial_reconnect_backoff_ms", 200),
    ("grpc.min_reconnect_backoff_ms", 500),
    ("grpc.max_reconnect_backoff_ms", 1_000),
)


@dataclass(frozen=True, slots=True)
class Inspection:
    """A worker's verdict on a capture; `failure` says why it cannot be used."""

    kind: str
    format: str
    frames: int
    points: int
    warnings: tuple[str, ...]
    failure: Problem | None


class EdgePool:
    """The workers that the settings name; each has one channel, opened when first needed."""

    def __init__(
        self,
        addresses: Sequence[str],
        *,
        silence_s: float = 15.0,
        job_timeout_s: float = 6 * 3600.0,
        caller: Caller = PLAIN,
    ) -> None:
        """silence_s: how long a stream may say nothing; job_timeout_s: deadline of a whole run."""
        self.addresses = tuple(addresses)
        self._offers: dict[str, tuple[Preset, ...]] = {}
        self._silence_s = silence_s
        self._job_timeout_s = job_timeout_s
        self._caller = caller
        self._channels: dict[str, grpc.aio.Channel] = {}
        self._faults: dict[str, grpc.StatusCode] = {}

    @property
    def presets(self) -> dict[str, Preset]:
        """What the workers heard of so far offer, by name, even those that are away: they come back.

        Where several offer a preset, the bound is the largest of theirs.
        """
        found: dict[str, Preset] = {}
        for address in self.addresses:
            for preset in self._offers.get(address, ()):
                known = found.get(preset.name, preset)
                found[preset.name] = max(known, preset, key=lambda each: each.memory_bytes)
        return found

    async def workers(self) -> tuple[WorkerStatus, ...]:
        """Those that answer within a second, in the settings' order; remembers the presets they offer."""
        answers = await asyncio.gather(*map(self._status, self.addresses))
        found = tuple(status for status in answers if status is not None)
        self._offers.update({status.address: status.presets for status in found})
        return found

    async def inspect(self, archive: Path) -> Inspection | None:
        """A worker's verdict on a packed capture; None when no worker can give one now."""
        for status in sorted(await self.workers(), key=lambda status: (status.draining, -status.free_slots)):
            try:
                return await self._inspect(status.address, archive)
            except (WorkerBusy, WorkerLost):
                continue
        return None

    async def reconstruct(
        self, address: str, job: Job, data: AsyncIterator[bytes], size: int
    ) -> AsyncGenerator[Report, None]:
        """Run the job there: send `data` (`size` bytes in all), then yield reports up to a `Failed` or `Finished`.

        Raises WorkerBusy, WorkerLost, RunKnown, Problem, and whatever reading `data` raises.
        """
        call = self._stub(address).Reconstruct(timeout=self._job_timeout_s)
        silence = _Silence(self._silence_s)
        upload = asyncio.create_task(_upload(call, _header(job, size), data, silence.broken))
        try:
            async with aclosing(_reports(call, silence)) as reports:
                async for report in reports:
                    yield report
        except WorkerLost:
            # An upload that failed on our side reaches us as the worker's complaint about it.
            if upload.done() and not upload.cancelled() and (error := upload.exception()):
                raise error from None
            raise
        finally:
            upload.cancel()
            call.cancel()
            await asyncio.wait([upload])

    async def attach(self, address: str, job: str, after_seq: int) -> AsyncGenerator[Report, None]:
        """The reports of a run beyond `after_seq`, up to a `Failed` or `Finished`. Raises WorkerLost, RunUnknown."""
        request = pb.AttachRequest(job=job, after_seq=after_seq)
        call = self._stub(address).Attach(request, timeout=self._job_timeout_s)
        try:
            async with aclosing(_reports(call, _Silence(self._silence_s))) as reports:
                async for report in reports:
                    yield report
        finally:
            call.cancel()

    async def cancel(self, address: str, job: str) -> bool:
        """Stop a run; whether there was one to stop. Raises WorkerLost."""
        try:
            reply = await self._stub(address).Cancel(pb.CancelRequest(job=job), timeout=CANCEL_S)
        except grpc.aio.AioRpcError as error:
            raise WorkerLost(f"{address}: {error.details()}") from None
        return bool(reply.was_running)

    async def close(self) -> None:
        """Close the channels; open streams end."""
        await asyncio.gather(*(channel.close() for channel in self._channels.values()))

    async def _status(self, address: str) -> WorkerStatus | None:
        try:
            worker = await self._stub(address).GetWorker(pb.GetWorkerRequest(), timeout=POLL_S)
        except grpc.aio.AioRpcError as error:
            self._hear_fault(address, error)
            return None
        self._faults.pop(address, None)
        return WorkerStatus(
            address,
            worker.version,
            worker.device,
            tuple(Preset(each.name, each.summary, each.trained, each.memory_bytes) for each in worker.presets),
            worker.slots,
            worker.free_slots,
            worker.queued,
            worker.draining,
            frozenset(worker.jobs),
        )

    def _hear_fault(self, address: str, error: grpc.aio.AioRpcError) -> None:
        """Log why a worker does not answer, once: a wrong token or certificate looks like an absent worker else."""
        if self._faults.get(address) != error.code():
            self._faults[address] = error.code()
            _log.warning("worker %s does not answer: %s: %s", address, error.code().name, error.details())

    async def _inspect(self, address: str, archive: Path) -> Inspection:
        call = self._stub(address).Inspect(timeout=INSPECT_S)
        size = archive.stat().st_size
        header = pb.Header(job=archive.stem, capture_bytes=size)
        upload = asyncio.create_task(_upload(call, header, _file_chunks(archive)))
        try:
            answer = await call
        except grpc.aio.AioRpcError as error:
            raise _translated(error) from None
        finally:
            upload.cancel()
            call.cancel()
        failure = problem_of(_failed(0, answer.failure)) if answer.HasField("failure") else None
        return Inspection(answer.kind, answer.format, answer.frames, answer.points, tuple(answer.warnings), failure)

    def _stub(self, address: str) -> Any:
        if address not in self._channels:
            self._channels[address] = self._caller.aio_channel(address, _OPTIONS)
        return edge_pb2_grpc.EdgeReconstructionStub(self._channels[address])  # type: ignore[no-untyped-call]


class _Silence:
    """How long a stream may be silent; sending an upload counts as hearing of it."""

    def __init__(self, seconds: float) -> None:
        self.seconds = seconds
        self.limit: asyncio.Timeout | None = None

    def broken(self) -> None:
        if self.limit is not None and not self.limit.expired():
            self.limit.reschedule(asyncio.get_running_loop().time() + self.seconds)


def _header(job: Job, size: int) -> pb.Header:
    order = job.order
    return pb.Header(
        job=job.id,
        fence=job.lease.fence,
        preset=order.preset,
        asset_key=order.asset_key,
        target=order.target,
        isolate=order.isolate,
        capture_bytes=size,
        label=order.label,
        longest_m=order.longest_m or 0.0,
        collection=order.collection,
    )


async def _upload(
    call: Any, header: pb.Header, data: AsyncIterator[bytes], sent: Callable[[], None] = lambda: None
) -> None:
    """Header, data, trailer. A worker that hangs up says why in its status; when `data` fails, no trailer is sent."""
    digest = hashlib.sha256()
    offset = 0
    try:
        await call.write(pb.Chunk(header=header))
        # The worker admits the upload by its metadata. A refusal that overtook a write would reach us as INTERNAL.
        await call.initial_metadata()
        try:
            async for block in data:
                digest.update(block)
                await call.write(pb.Chunk(data=pb.Data(offset=offset, data=block)))
                offset += len(block)
                sent()
            await call.write(pb.Chunk(trailer=pb.Trailer(sha256=digest.digest())))
        finally:
            await call.done_writing()
    except (grpc.aio.AioRpcError, asyncio.InvalidStateError):
        return


async def _file_chunks(path: Path) -> AsyncIterator[bytes]:
    with path.open("rb") as file:
        while block := await asyncio.to_thread(file.read, CHUNK_BYTES):
            yield block


async def _reports(call: Any, silence: _Silence) -> AsyncGenerator[Report, None]:
    while True:
        try:
            async with asyncio.timeout(silence.seconds) as silence.limit:
                event = await call.read()
        except grpc.aio.AioRpcError as error:
            raise _translated(error) from None
        except TimeoutError:
            raise WorkerLost(f"not a word for {silence.seconds:g} s") from None
        if event is grpc.aio.EOF:
            raise WorkerLost("the stream ended before the run did")
        report = _report(event)
        yield report
        if isinstance(report, Failed | Finished):
            return


def _report(event: pb.Event) -> Report:
    match event.WhichOneof("what"):
        case "progress":
            said = event.progress
            stage = _stage(said.stage)
            return Progressed(event.seq, stage, said.fraction, dict(said.losses), said.eta_s, said.message)
        case "published":
            made = event.published
            return Published(event.seq, made.asset_key, made.version, made.state, made.manifest, made.collection)
        case "failure":
            return _failed(event.seq, event.failure)
        case "finished":
            return Finished(event.seq, tuple(event.finished.warnings), dict(event.finished.seconds))
        case _:  # a heartbeat, or something that a newer worker says and we need not know
            return Beat(event.seq)


def _failed(seq: int, failure: pb.Failure) -> Failed:
    hints = tuple(failure.hints)
    stage = _stage(failure.stage)
    return Failed(seq, failure.code, failure.message, failure.file, hints, failure.retryable, stage)


def _stage(stage: int) -> str:
    """The name of a stage; "" for none, and for one that only a newer worker knows."""
    name: str = pb.Stage.Name(stage) if stage in pb.Stage.values()[1:] else ""
    return name


def _translated(error: grpc.aio.AioRpcError) -> Exception:
    details = error.details() or error.code().name
    code, _, sentence = details.partition(": ")
    match error.code():
        case grpc.StatusCode.RESOURCE_EXHAUSTED:
            return WorkerBusy(details)
        case grpc.StatusCode.UNAVAILABLE if code == "WORKER_DRAINING":
            return WorkerBusy(details)
        case grpc.StatusCode.UNAVAILABLE:
            return WorkerUnreachable(details)
        case grpc.StatusCode.ALREADY_EXISTS:
            return RunKnown(details)
        case grpc.StatusCode.NOT_FOUND | grpc.StatusCode.OUT_OF_RANGE:
            return RunUnknown(details)
        case grpc.StatusCode.INVALID_ARGUMENT:
            return Problem(422, code if code.isupper() else "WORKER_REFUSED", sentence or details)
        case _:
            return WorkerLost(f"{error.code().name}: {details}")
