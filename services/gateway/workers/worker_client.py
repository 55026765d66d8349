"""gRPC client for the workers: poll their status, inspect captures, run, follow and cancel jobs.

The only module of the gateway that uses gRPC. A call returns the gateway's own types, or raises an exception of
worker_types.py, or a `Problem` where another worker would fail in the same way.
"""

from __future__ import annotations

import asyncio
import logging
import math
import time
from collections import Counter
from collections.abc import AsyncGenerator, Callable, Collection, Iterator, Sequence
from contextlib import aclosing, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import grpc

import capture2vr
from capture2vr.edge.api import edge_pb2 as pb
from capture2vr.edge.api.grpc_client import CHUNK_BYTES as CHUNK_BYTES  # read by those who send captures
from capture2vr.edge.api.grpc_client import RUN_S, SILENCE_S, GrpcClient, StreamEnded, file_chunks
from capture2vr.edge.api.header_options import header_fields, wire_box
from capture2vr.gateway.errors import RETRY_S, Problem
from capture2vr.gateway.jobs.job import Job
from capture2vr.gateway.jobs.reports import (
    AnchorsFound,
    Report,
    RunFailed,
    RunFinished,
    RunHeartbeat,
    RunProgress,
    VersionPublished,
)
from capture2vr.gateway.jobs.state_machine import problem_of
from capture2vr.gateway.workers.worker_addresses import WorkerAddresses, target_and_name
from capture2vr.gateway.workers.worker_types import (
    RunKnown,
    RunOutOfMemory,
    RunUnknown,
    WorkerBusy,
    WorkerLost,
    WorkerPreset,
    WorkerStatus,
    WorkerUnreachable,
)
from capture2vr.order.photo_box import PhotoBox
from capture2vr.process.grpc_security import NO_CREDENTIALS, ClientCredentials
from capture2vr.sentences.documents import read_codes
from capture2vr.sentences.sentence import say
from capture2vr.storage.catalogue.downloads import DownloadOrder, StoredDownload

_log = logging.getLogger(__name__)

POLL_S = 1.0  # deadline of a status request: a worker that needs longer counts as absent
INSPECT_S = 440.0  # deadline of an inspection: uploading 2 GB within a data centre, and the worker's own limit
_INSPECTOR_S = 20.0  # that an upload waits for a worker: one that is restarted is back before
DOWNLOAD_S = 900.0  # deadline of a download: those before it in the worker's line, and then its own five minutes
CANCEL_S = 2.0  # deadline of a cancellation; it is repeated until the run ends
_MOST_ANCHORS = 1_000  # points: every event is stored, and sent to every page that follows the job


Outline = tuple[tuple[float, float], ...]


@dataclass(frozen=True, slots=True)
class Inspection:
    """What a worker found in a capture.

    failure  why it cannot be reconstructed, or None
    outline  closed lines around the thing in a single photo, of corners (x, y) as shares of its width and height
    """

    kind: str
    format: str
    frames: int
    points: int
    warnings: tuple[str, ...]
    failure: Problem | None
    outline: tuple[Outline, ...] = ()


class WorkerPool:
    """The workers named in the settings, each with one gRPC channel that is opened at first use.

    A worker that its name no longer resolves to gets no new jobs; its channel is closed when the last run on it ended.
    """

    def __init__(
        self,
        addresses: Sequence[str],
        *,
        silence_s: float = SILENCE_S,
        job_timeout_s: float = RUN_S,
        credentials: ClientCredentials = NO_CREDENTIALS,
    ) -> None:
        """silence_s: a stream without a message for so long is dead; job_timeout_s: deadline of a run's first call"""
        self._addresses = WorkerAddresses(addresses)
        self._presets_by_worker: dict[str, tuple[WorkerPreset, ...]] = {}
        self._statuses: dict[str, WorkerStatus] = {}  # of those that answered when they were asked last
        self._silence_s = silence_s
        self._job_timeout_s = job_timeout_s
        self._credentials = credentials
        self._clients: dict[str, GrpcClient] = {}
        self._calls: Counter[str] = Counter()  # long calls that go on, by address
        self._faults: dict[str, grpc.StatusCode | str] = {}

    @property
    def addresses(self) -> tuple[str, ...]:
        """Addresses of all workers, as far as they are known."""
        return self._addresses.current

    @property
    def unresolved(self) -> tuple[str, ...]:
        """Names in the settings that resolve to no address."""
        return self._addresses.unresolved

    @property
    def presets(self) -> dict[str, WorkerPreset]:
        """Presets of all known workers that have ever answered, by name, of those that are away too: they may come
        back.

        Where several workers offer a preset, the one with the largest memory_bytes is returned.
        """
        found: dict[str, WorkerPreset] = {}
        for address in self.addresses:
            for preset in self._presets_by_worker.get(address, ()):
                known = found.get(preset.name, preset)
                found[preset.name] = max(known, preset, key=lambda each: each.memory_bytes)
        return found

    def last_status(self, address: str) -> WorkerStatus | None:
        """Return what a worker said of itself when it was asked last; None where it did not answer, or is gone."""
        return self._statuses.get(address)

    async def look_up(self) -> tuple[str, ...]:
        """Look the names in the settings up again, if that was long ago, and return the addresses of all workers."""
        await self._addresses.refresh()
        await self._close_unused()
        return self.addresses

    async def poll(self, only: Collection[str] | None = None) -> tuple[WorkerStatus, ...]:
        """Ask all workers for their status, or only those of these addresses, and remember their presets.

        Returns those that answer within a second, in the settings' order. Not all are compatible.
        """
        addresses = await self.look_up()
        asked = [address for address in addresses if only is None or address in only]
        answers = await asyncio.gather(*map(self._status, asked))
        found = tuple(status for status in answers if status is not None)
        usable = [status for status in found if status.is_compatible]
        self._presets_by_worker.update({status.address: status.presets for status in usable})
        return found

    async def inspect(self, archive: Path, box: PhotoBox | None, spend: Callable[[float], None]) -> Inspection:
        """Have a worker inspect a packed capture, as soon as one can.

        box    rectangle around the object in a photo
        spend  is told the processor seconds that it took, or where the worker does not tell, those of the clock

        Raises Problem INSPECTION_UNAVAILABLE where none can within `_INSPECTOR_S`.
        """
        give_up = time.monotonic() + _INSPECTOR_S
        while True:
            usable = [status for status in await self.poll() if status.is_compatible]
            for status in sorted(usable, key=lambda status: (status.draining, -status.free_slots)):
                try:
                    with self._calling(status.address) as client:
                        return await _inspect(client, archive, box, spend)
                except (WorkerBusy, WorkerLost) as error:
                    _log.info("worker %s does not inspect %s now: %s", status.address, archive.stem, error)
            if time.monotonic() > give_up:
                raise _not_inspected()
            await asyncio.sleep(POLL_S)

    async def make_download(self, address: str, tenant: str, order: DownloadOrder) -> StoredDownload:
        """Have a worker convert an asset of a tenant to another format, and write the file to the store.

        Raises WorkerBusy, WorkerLost, and Problem where the asset cannot be converted.
        """
        request = pb.DownloadRequest(
            tenant=tenant, asset_key=order.key, manifest=order.manifest, format=order.format.name
        )
        with self._calling(address) as client:
            try:
                answer = await client.make_download(request, DOWNLOAD_S)
            except grpc.aio.AioRpcError as error:
                raise _to_exception(error.code(), error.details() or error.code().name) from None
        if not answer.HasField("failure"):
            return StoredDownload(answer.name, answer.bytes)
        if answer.failure.retryable:
            raise WorkerBusy(answer.failure.message)
        raise problem_of(_failed(0, answer.failure))

    async def reconstruct(
        self, address: str, job: Job, data: AsyncGenerator[bytes, None], size: int
    ) -> AsyncGenerator[Report, None]:
        """Run a job on a worker: send `data` (`size` bytes), then yield reports up to `RunFailed` or `RunFinished`.

        Raises WorkerBusy, WorkerLost, RunKnown, Problem, and whatever reading `data` raises.
        """
        with self._calling(address) as client:
            async with aclosing(_reports(client.reconstruct(_header(job, size), data))) as reports:
                async for report in reports:
                    yield report

    async def follow(self, address: str, job: Job, after_seq: int, give_up_s: float) -> AsyncGenerator[Report, None]:
        """Yield a run's reports after number `after_seq`, up to `RunFailed` or `RunFinished`, reconnecting if needed.

        Raises RunUnknown, and WorkerLost, WorkerBusy or WorkerUnreachable when nothing was received for `give_up_s`.
        """
        with self._calling(address) as client:
            events = client.follow(job.id, job.token, after_seq, give_up_s=give_up_s)
            async with aclosing(_reports(events)) as reports:
                async for report in reports:
                    yield report

    async def make_room(self, address: str, job: Job) -> bool:
        """Have a run yield its slot, if it can go on from a checkpoint later, and return whether it does.

        Its last report is then a `RunFailed` JOB_YIELDED. Raises WorkerLost.
        """
        with self._calling(address) as client:
            try:
                return await client.make_room(job.id, job.token, CANCEL_S)
            except grpc.aio.AioRpcError as error:
                raise WorkerLost(f"{address}: {error.details()}") from None

    async def cancel(self, address: str, job: Job) -> bool:
        """Cancel a run, and return whether the worker had it. Raises WorkerLost."""
        with self._calling(address) as client:
            try:
                return await client.cancel(job.id, job.token, CANCEL_S)
            except grpc.aio.AioRpcError as error:
                raise WorkerLost(f"{address}: {error.details()}") from None

    async def close(self) -> None:
        """Close the channels, which ends open streams."""
        await self._addresses.close()
        await asyncio.gather(*(client.close() for client in self._clients.values()))

    async def _status(self, address: str) -> WorkerStatus | None:
        try:
            worker = await self._client(address).worker(POLL_S)
        except grpc.aio.AioRpcError as error:
            self._statuses.pop(address, None)
            self._log_fault(address, error.code(), f"does not answer: {error.code().name}: {error.details()}")
            return None
        status = WorkerStatus(
            address,
            worker.version,
            worker.device,
            tuple(_preset(each) for each in worker.presets),
            worker.slots,
            worker.free_slots,
            worker.queued,
            worker.draining,
            frozenset(worker.jobs),
            worker.memory_bytes,
        )
        self._statuses[address] = status
        if status.is_compatible:
            self._faults.pop(address, None)
        else:
            ours = capture2vr.__version__
            why = f"is of version {status.version}, and this gateway of {ours}: it gets no jobs; update the older one"
            self._log_fault(address, status.version, why)
        return status

    def _log_fault(self, address: str, fault: grpc.StatusCode | str, why: str) -> None:
        """Log once why a worker gets no jobs; otherwise a wrong token or certificate would look like absence."""
        if self._faults.get(address) != fault:
            self._faults[address] = fault
            _log.warning("worker %s %s", address, why)

    @contextmanager
    def _calling(self, address: str) -> Iterator[GrpcClient]:
        """The client of a worker, for a call during which its channel must stay."""
        self._calls[address] += 1
        try:
            yield self._client(address)
        finally:
            self._calls[address] -= 1

    async def _close_unused(self) -> None:
        """Close the channels of workers that are gone by their names, once no call uses them."""
        for address in self._statuses.keys() - set(self.addresses):
            del self._statuses[address]
        gone = [each for each in self._clients if each not in self.addresses and not self._calls[each]]
        clients = [self._clients.pop(address) for address in gone]
        for address in gone:
            self._presets_by_worker.pop(address, None)
            self._faults.pop(address, None)
        await asyncio.gather(*(client.close() for client in clients))

    def _client(self, address: str) -> GrpcClient:
        if address not in self._clients:
            target, name = target_and_name(address)
            self._clients[address] = GrpcClient(
                target, self._credentials, name=name, silence_s=self._silence_s, run_s=self._job_timeout_s
            )
        return self._clients[address]


async def _inspect(
    client: GrpcClient, archive: Path, box: PhotoBox | None, spend: Callable[[float], None]
) -> Inspection:
    header = pb.Header(job=archive.stem, capture_bytes=archive.stat().st_size, box=wire_box(box))
    began, took_s = time.monotonic(), 0.0
    try:
        answer = await client.inspect(header, file_chunks(archive), INSPECT_S)
        took_s = answer.processor_s
    except grpc.aio.AioRpcError as error:
        raise _to_exception(error.code(), error.details() or error.code().name) from None
    finally:
        spend(took_s or time.monotonic() - began)
    failure = problem_of(_failed(0, answer.failure)) if answer.HasField("failure") else None
    outline = tuple(tuple(zip(line.xy[::2], line.xy[1::2], strict=True)) for line in answer.outline)
    warnings = _coded_warnings(answer)
    return Inspection(answer.kind, answer.format, answer.frames, answer.points, warnings, failure, outline)


def _not_inspected() -> Problem:
    headers = {"Retry-After": str(RETRY_S)}
    return Problem(503, "INSPECTION_UNAVAILABLE", say("no_worker_can_inspect"), retryable=True, headers=headers)


def _header(job: Job, size: int) -> pb.Header:
    return pb.Header(
        job=job.id,
        fence=job.lease.fence,
        asset_key=job.order.asset_key,
        capture_bytes=size,
        tenant=job.tenant,
        token=job.token,
        capture=job.order.capture,
        most_seconds=job.seconds_left,
        **header_fields(job.order.options),
    )


async def _reports(events: AsyncGenerator[pb.Event, None]) -> AsyncGenerator[Report, None]:
    async with aclosing(events):
        try:
            async for event in events:
                yield _report(event)
        except StreamEnded as ended:
            raise _to_exception(ended.status, str(ended)) from None


def _report(event: pb.Event) -> Report:
    match event.WhichOneof("what"):
        case "progress":
            step = event.progress
            stage = _stage(step.stage)
            message = read_codes(step.i18n, message=step.message)["message"]
            return RunProgress(event.seq, stage, step.fraction, dict(step.losses), step.eta_s, message)
        case "anchors" if _are_anchors(event.anchors):
            xyz_m = tuple(round(value, 4) for value in event.anchors.xyz_m)
            return AnchorsFound(event.seq, xyz_m, tuple(event.anchors.rgb))
        case "published":
            return _version_published(event.seq, event.published)
        case "failure":
            return replace(_failed(event.seq, event.failure), ran_s=event.elapsed_s)
        case "finished":
            warnings = _coded_warnings(event.finished)
            return RunFinished(event.seq, warnings, dict(event.finished.seconds))
        case _:  # a heartbeat, anchors that cannot be shown, or a kind of event that only newer workers send
            return RunHeartbeat(event.seq)


def _version_published(seq: int, asset: pb.Published) -> VersionPublished:
    said = asset.grade
    grade = None
    if asset.HasField("grade"):
        grade = {"level": said.level, **read_codes(said.i18n, because=said.because, advice=said.advice)}
    return VersionPublished(
        seq, asset.asset_key, asset.version, asset.state, asset.manifest, asset.collection, grade, asset.held
    )


def _are_anchors(anchors: pb.AnchorPoints) -> bool:
    """Whether they can be stored and shown: finite, with three colours a point, and no more than promised."""
    count = len(anchors.rgb)
    return (
        0 < count <= 3 * _MOST_ANCHORS
        and count % 3 == 0
        and len(anchors.xyz_m) == count
        and all(map(math.isfinite, anchors.xyz_m))
    )


def _failed(seq: int, failure: pb.Failure) -> RunFailed:
    said = read_codes(failure.i18n, message=failure.message, hints=list(failure.hints))
    stage, hints = _stage(failure.stage), tuple(said["hints"])
    return RunFailed(seq, failure.code, said["message"], failure.file, hints, failure.retryable, stage)


def _coded_warnings(answer: pb.Inspection | pb.Finished) -> tuple[str, ...]:
    return tuple(read_codes(answer.i18n, warnings=list(answer.warnings))["warnings"])


def _preset(preset: pb.Preset) -> WorkerPreset:
    said = read_codes(preset.i18n, summary=preset.summary, takes=preset.takes)
    return WorkerPreset(
        preset.name, said["summary"], preset.trained, preset.memory_bytes, preset.literature, said["takes"]
    )


def _stage(stage: int) -> str:
    """Return the name of a stage; "" for none, and for one that only newer workers know."""
    name: str = pb.Stage.Name(stage) if stage in pb.Stage.values()[1:] else ""
    return name


def _to_exception(status: grpc.StatusCode | None, details: str) -> Exception:
    """Return the exception for a call that ended with this gRPC status; None: the stream broke off without one."""
    code, _, sentence = details.partition(": ")
    match status:
        case None:
            return WorkerLost(details)
        case grpc.StatusCode.RESOURCE_EXHAUSTED:
            return WorkerBusy(details)
        case grpc.StatusCode.UNAVAILABLE if code == "WORKER_DRAINING":
            return WorkerBusy(details)
        case grpc.StatusCode.UNAVAILABLE:
            return WorkerUnreachable(details)
        case grpc.StatusCode.ALREADY_EXISTS:
            return RunKnown(details)
        case grpc.StatusCode.NOT_FOUND | grpc.StatusCode.OUT_OF_RANGE:
            return RunOutOfMemory(details) if code == "OUT_OF_MEMORY" else RunUnknown(details)
        case grpc.StatusCode.INVALID_ARGUMENT:
            return Problem(422, code if code.isupper() else "WORKER_REFUSED", sentence or details)
        case _:
            return WorkerLost(f"{status.name}: {details}")
