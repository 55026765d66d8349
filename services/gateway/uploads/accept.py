"""Upload of a capture: receive, unpack, validate, pack, have a worker inspect it, store. All of it or nothing."""

from __future__ import annotations

import asyncio
import json
import shutil
import tempfile
import time
from collections.abc import AsyncIterator, Callable, Coroutine, Sequence
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import anyio.to_thread
from anyio import CapacityLimiter
from starlette.requests import ClientDisconnect, Request

from capture2vr.gateway.database.disk_reserve import RESERVE_BYTES
from capture2vr.gateway.database.full_disk import is_disk_full
from capture2vr.gateway.errors import Problem, storage_full
from capture2vr.gateway.jobs.capture_objects import capture_name, put_private, receipt_name, unknown_capture
from capture2vr.gateway.jobs.collection_choice import require_collection
from capture2vr.gateway.settings import GatewaySettings
from capture2vr.gateway.uploads.check_and_pack import CheckOrder, PackedFiles, earlier_archive_of
from capture2vr.gateway.uploads.check_processes import CheckProcesses
from capture2vr.gateway.uploads.receive import ReceivedUpload, UploadBody, UploadLimits, body_of, receive
from capture2vr.gateway.uploads.refusal import Refused
from capture2vr.gateway.uploads.turns import Turns
from capture2vr.gateway.uploads.validate import FileReport
from capture2vr.gateway.workers.worker_client import Inspection, WorkerPool
from capture2vr.order.one_line import one_line
from capture2vr.order.photo_box import PhotoBox
from capture2vr.process.traces import capture_span
from capture2vr.sentences.documents import with_codes
from capture2vr.sentences.sentence import say
from capture2vr.storage.store import Store

_WRITERS = 8  # threads: writing to disk is mostly waiting
_COPIES = 3  # of an upload on the disk at worst: as received, unpacked, packed
_ABANDONED_S = 24 * 3600.0  # a staging folder or file of this age was left by a gateway that crashed

_T = TypeVar("_T")


@dataclass(frozen=True, slots=True)
class Uploader:
    """Whose upload it is, and what it may cost.

    processor_s  processor seconds a minute for checks and inspections of the tenant's uploads; 0: no limit
    check_size   raises Problem for a capture of so many bytes; called before anything is read, and when it is packed
    """

    tenant: str
    processor_s: int
    check_size: Callable[[int], None]


@dataclass(frozen=True, slots=True)
class _InspectedCapture:
    """A validated, packed and inspected capture, with its hash, its names, and the result for each file."""

    archive: Path
    sha256: str
    name: str
    collection: str
    verdicts: Sequence[FileReport]
    inspection: Inspection


@dataclass(frozen=True, slots=True)
class _Earlier:
    """A stored capture, to which the photos of an upload are added."""

    store: Store
    capture: str

    def fetch(self, archive: Path) -> None:
        """Copy its archive from the store. Raises Problem CAPTURE_UNKNOWN, STORE_UNAVAILABLE; OSError (full disk)."""
        try:
            self.store.fetch(capture_name(self.capture), archive)
        except (FileNotFoundError, ValueError):
            raise unknown_capture(self.capture) from None
        except OSError as error:
            if is_disk_full(error):
                raise
            detail = say("earlier_capture_could")
            raise Problem(503, "STORE_UNAVAILABLE", detail, retryable=True) from error


class Uploads:
    """Accepts uploads, many at once: threads write them to disk, processes check them, and workers inspect them.

    Must be created on the event loop that serves the requests.
    """

    def __init__(self, settings: GatewaySettings, workers: WorkerPool, checks: CheckProcesses) -> None:
        self._limits = UploadLimits(settings.max_upload_bytes, settings.max_files)
        self._workers = workers
        self._staging = settings.data_dir / "uploads"
        self._checks = checks
        self._turns = Turns()
        self._writers = CapacityLimiter(_WRITERS)
        self._staging.mkdir(parents=True, exist_ok=True)
        _remove_abandoned(self._staging)

    async def accept(
        self,
        request: Request,
        body: UploadBody,
        store: Store,
        box: PhotoBox | None,
        uploader: Uploader,
        capture: str,
        continues: str = "",
    ) -> dict[str, Any]:
        """Store the capture in a body and return its receipt. Raises Problem; on any error nothing is left behind.

        request     whose client waits for the receipt: when it leaves, the work ends
        store       of the caller's tenant
        capture     the new capture's id
        box         rectangle around the object in a photo, for its inspection
        continues   id of the stored capture whose photos the new one has too; "": none
        """
        uploader.check_size(body.size)
        with capture_span("receive capture", capture):
            earlier = _Earlier(store, continues) if continues else None
            async with self._inspected(request, body, box, uploader, earlier) as inspected:
                uploader.check_size(inspected.archive.stat().st_size)
                return await self._store_capture(store, _receipt(capture, continues, inspected), inspected.archive)

    async def outline(self, request: Request, box: PhotoBox | None, uploader: Uploader) -> dict[str, Any]:
        """Return the outline of the thing in the request's photo; stores nothing. Raises Problem."""
        body = body_of(request)
        uploader.check_size(body.size)
        async with self._inspected(request, body, box, uploader) as inspected:
            uploader.check_size(inspected.archive.stat().st_size)
            found = inspected.inspection
            return {"kind": found.kind, "outline": found.outline, "warnings": found.warnings}

    @asynccontextmanager
    async def _inspected(
        self,
        request: Request,
        body: UploadBody,
        box: PhotoBox | None,
        uploader: Uploader,
        earlier: _Earlier | None = None,
    ) -> AsyncIterator[_InspectedCapture]:
        """Receive, check and pack the capture in a body, and have it inspected; its files are removed afterwards.

        Raises Problem.
        """
        self.check_free_space(body.size)
        folder = Path(tempfile.mkdtemp(prefix="upload-", dir=self._staging))
        try:
            if earlier:
                await self._write(partial(earlier.fetch, earlier_archive_of(folder)))
            received = await receive(body, folder / "in", self._limits, self._write)
            name, collection = _check_fields(received)
            order = self._order(folder, received, continues=earlier is not None)
            files, inspection = await _unless_client_leaves(request, self._inspect(order, box, uploader))
            yield _InspectedCapture(files.archive, files.sha256, name, collection, files.verdicts, inspection)
        except Refused as refused:
            raise Problem(refused.status, refused.code, refused.detail, hints=refused.hints) from None
        except OSError as error:
            if is_disk_full(error):
                raise storage_full() from None
            raise
        finally:
            # In a thread, because deleting thousands of files takes a while; shielded, so that a client's disconnect
            # does not stop it.
            await asyncio.shield(asyncio.to_thread(shutil.rmtree, folder, ignore_errors=True))

    async def _inspect(
        self, order: CheckOrder, box: PhotoBox | None, uploader: Uploader
    ) -> tuple[PackedFiles, Inspection]:
        """Wait for a turn, then check and pack the files, and have a worker inspect them. Raises Problem."""
        async with self._turns.turn(uploader.tenant, uploader.processor_s) as spend:
            files = await self._checks.check(order, spend)
            inspection = await self._workers.inspect(files.archive, box, spend)
        if inspection.failure is not None:
            raise inspection.failure
        return files, inspection

    def check_free_space(self, size: int) -> None:
        """Refuse an upload of so many bytes that does not fit on the disk, before reading it. Raises Problem."""
        if size * _COPIES > shutil.disk_usage(self._staging).free - RESERVE_BYTES:  # deletions need some space
            raise storage_full()

    async def _store_capture(self, store: Store, receipt: dict[str, Any], archive: Path) -> dict[str, Any]:
        """Store the archive, then its receipt: a receipt on the store means that the capture is complete."""
        capture = receipt["capture"]
        try:
            await self._write(lambda: put_private(store, capture_name(capture), archive, "application/zip"))
            document = _json_bytes(receipt)
            await self._write(lambda: put_private(store, receipt_name(capture), document, "application/json"))
        except BaseException:
            await asyncio.shield(asyncio.to_thread(_remove, store, capture))
            raise
        return receipt

    async def _write(self, work: Callable[[], None]) -> None:
        await anyio.to_thread.run_sync(work, limiter=self._writers)

    def _order(self, folder: Path, received: ReceivedUpload, *, continues: bool) -> CheckOrder:
        return CheckOrder(
            folder=str(folder.absolute()),
            names=received.files,
            has_client_names=received.has_client_names,
            most_files=self._limits.files,
            most_bytes=self._limits.total_bytes,
            continues=continues,
        )


def _remove(store: Store, capture: str) -> None:
    for name in (capture_name(capture), receipt_name(capture)):
        try:
            store.delete(name)
        except OSError:
            continue  # the store cannot be reached; a leftover is harmless, because no client knows this id


async def _unless_client_leaves(request: Request, work: Coroutine[Any, Any, _T]) -> _T:
    """Await the work, and cancel it as soon as the client has disconnected: nobody would get the answer.

    Raises ClientDisconnect, and what the work raises.
    """
    working, leaving = asyncio.create_task(work), asyncio.create_task(_disconnected(request))
    try:
        await asyncio.wait((working, leaving), return_when=asyncio.FIRST_COMPLETED)
        if not working.done():
            raise ClientDisconnect
        return working.result()
    finally:
        leaving.cancel()
        working.cancel()
        await asyncio.gather(working, leaving, return_exceptions=True)


async def _disconnected(request: Request) -> None:
    """Return when the client of a request, whose body has been read, has disconnected."""
    while (await request.receive())["type"] != "http.disconnect":
        pass


def _check_fields(received: ReceivedUpload) -> tuple[str, str]:
    """Return the capture's name and collection from the form's text fields. Raises Problem."""
    if not received.files:
        raise Problem(422, "CAPTURE_EMPTY", say("upload_has_no_files"), hints=(say("choose_least_one_file"),))
    if collection := received.fields.get("collection", ""):
        require_collection(collection, say("change_field_collection_leave"))
    try:
        return one_line(received.fields.get("name", "")[:200]), collection
    except ValueError as error:
        raise Problem(422, "NAME_INVALID", str(error), hints=(say("change_field_name"),)) from None


def _receipt(capture: str, continues: str, packed: _InspectedCapture) -> dict[str, Any]:
    """Return the receipt: the answer to the upload, which is also stored."""
    facts = packed.inspection
    return {
        "capture": capture,
        "name": packed.name,
        "collection": packed.collection,
        "continues": continues,
        "created": datetime.now(UTC).isoformat(timespec="seconds").replace("+00:00", "Z"),
        "bytes": packed.archive.stat().st_size,
        "sha256": packed.sha256,
        "inspected": True,  # captures of former versions may not be
        "kind": facts.kind,
        "format": facts.format,
        "frames": facts.frames,
        "points": facts.points,
        "warnings": list(facts.warnings),
        "files": [verdict.document() for verdict in packed.verdicts],
    }


def _json_bytes(receipt: dict[str, Any]) -> bytes:
    return json.dumps(with_codes(receipt), ensure_ascii=False, separators=(",", ":")).encode()


def _remove_abandoned(staging: Path) -> None:
    for path in staging.iterdir():
        with suppress(FileNotFoundError):  # an upload's chunk, which has been stored meanwhile
            if time.time() - path.stat().st_mtime <= _ABANDONED_S:
                continue
            if path.is_dir():
                shutil.rmtree(path, ignore_errors=True)
            else:
                path.unlink()
