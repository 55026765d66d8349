"""From a request to a stored capture: receive, unpack, validate, pack, ask a worker, store. All of it or nothing."""

from __future__ import annotations

import asyncio
import errno
import hashlib
import json
import secrets
import shutil
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, TypeVar

import anyio.to_thread
from anyio import CapacityLimiter
from starlette.requests import Request

from services.gateway.edge import EdgePool, Inspection
from services.gateway.errors import Problem
from services.gateway.jobs.place import require_collection
from services.gateway.jobs.source import capture_name, receipt_name
from services.gateway.settings import GatewaySettings
from services.gateway.uploads.receive import Received, UploadLimits, receive, too_many_files
from services.gateway.uploads.validate import Verdict, validate
from services.storage.archives import ArchiveError, Limits, is_zip, pack, unpack
from services.storage.store import Store

# Disk writes wait more than they compute; decoding pictures is all computing, and holds one decoded picture per thread.
_WRITERS, _CHECKERS = 8, 2
_COPIES = 3  # what an upload takes on the disk at worst: as it came, unpacked, packed
_ABANDONED_S = 24 * 3600.0  # a staging folder that old was left by a gateway that died

_ZIPS = (".zip", ".r3d")  # names that promise an archive: other bytes under them are a broken one

_T = TypeVar("_T")


@dataclass(frozen=True, slots=True)
class _Checked:
    """A packed capture and what is known of it."""

    archive: Path
    sha256: str
    name: str
    collection: str
    verdicts: Sequence[Verdict]


class Uploads:
    """Takes uploads, many at once: bytes on their way through `_WRITERS` threads, pictures through `_CHECKERS`.

    Made on the event loop that serves the requests.
    """

    def __init__(self, settings: GatewaySettings, store: Store, edge: EdgePool) -> None:
        self._limits = UploadLimits(settings.max_upload_bytes, settings.max_files)
        self._store = store
        self._edge = edge
        self._staging = settings.data_dir / "uploads"
        self._writers, self._checkers = CapacityLimiter(_WRITERS), CapacityLimiter(_CHECKERS)
        self._staging.mkdir(parents=True, exist_ok=True)
        _remove_abandoned(self._staging)

    async def accept(self, request: Request) -> dict[str, Any]:
        """The receipt of a stored capture. Raises Problem; whatever goes wrong, nothing of the upload is left."""
        self._check_declared(request)
        folder = Path(tempfile.mkdtemp(prefix="upload-", dir=self._staging))
        try:
            received = await receive(request, folder / "in", self._limits, self._write)
            checked = await self._in_checker(lambda: _checked(received, folder, self._limits))
            inspection = await self._edge.inspect(checked.archive)
            if inspection is not None and inspection.failure is not None:
                raise inspection.failure
            return await self._stored(checked, inspection)
        except OSError as error:
            if error.errno in (errno.ENOSPC, errno.EDQUOT):
                raise _no_room() from None
            raise
        finally:
            # Not on the loop: thousands of files take a while. Shielded: a client that leaves must not leave its files.
            await asyncio.shield(asyncio.to_thread(shutil.rmtree, folder, ignore_errors=True))

    def _check_declared(self, request: Request) -> None:
        """Refuse before the first byte what is known to be too much."""
        length = request.headers.get("content-length", "")
        declared = int(length) if length.isascii() and length.isdigit() else 0
        if declared * _COPIES > shutil.disk_usage(self._staging).free:
            raise _no_room()

    async def _stored(self, checked: _Checked, inspection: Inspection | None) -> dict[str, Any]:
        """The archive, then its receipt: a receipt on the store means that the capture is there."""
        capture = f"cap_{int(time.time() * 1000):012x}{secrets.token_hex(8)}"
        receipt = _receipt(capture, checked, inspection)
        name = capture_name(capture)
        try:
            await self._write(lambda: self._put(name, checked.archive, "application/zip"))
            await self._write(lambda: self._put(receipt_name(capture), _encoded(receipt), "application/json"))
        except BaseException:
            await asyncio.shield(asyncio.to_thread(self._remove, capture))
            raise
        return receipt

    def _put(self, name: str, data: bytes | Path, content_type: str) -> None:
        try:
            self._store.put(name, data, content_type=content_type, cache_control="private, no-store")
        except OSError as error:
            if error.errno in (errno.ENOSPC, errno.EDQUOT):
                raise
            raise Problem(503, "STORE_UNAVAILABLE", "the capture could not be stored", retryable=True) from error

    def _remove(self, capture: str) -> None:
        for name in (capture_name(capture), receipt_name(capture)):
            try:
                self._store.delete(name)
            except OSError:
                continue  # the store is gone; what it may hold is unreferenced, for no client knows this capture's id

    async def _write(self, work: Callable[[], None]) -> None:
        await anyio.to_thread.run_sync(work, limiter=self._writers)

    async def _in_checker(self, work: Callable[[], _T]) -> _T:
        return await anyio.to_thread.run_sync(work, limiter=self._checkers)


def _checked(received: Received, folder: Path, limits: UploadLimits) -> _Checked:
    """Unpack if need be, validate and clean every file, pack. Raises Problem."""
    if not received.files:
        raise Problem(422, "CAPTURE_EMPTY", "the upload has no files", hints=("choose some files",))
    if collection := received.fields.get("collection", ""):
        require_collection(collection, "name another in the field `collection`, or none")
    source, names = received.folder, received.files
    if len(names) == 1 and (is_zip(source / names[0]) or names[0].lower().endswith(_ZIPS)):
        blamed = names[0] if received.named else ""
        source, names = folder / "files", _unpacked(source / names[0], folder / "files", limits, blamed)
    verdicts = validate(source, names)
    archive = folder / "capture.zip"
    pack(source, archive)
    with archive.open("rb") as file:
        sha256 = hashlib.file_digest(file, "sha256").hexdigest()
    return _Checked(archive, sha256, received.fields.get("name", "")[:200], collection, verdicts)


def _unpacked(archive: Path, into: Path, limits: UploadLimits, blamed: str) -> list[str]:
    """The names of the files that were in the archive; `blamed` is how the client knows it. Raises Problem."""
    try:
        files = unpack(archive, into, Limits(total_bytes=2 * limits.total_bytes))
    except ArchiveError as error:
        raise Problem(422, error.code, error.message, file=error.file or blamed, hints=error.hints) from None
    if not files:
        raise Problem(422, "CAPTURE_EMPTY", "the archive has no files", file=blamed, hints=("zip the files again",))
    if len(files) > limits.files:
        raise too_many_files(limits)
    archive.unlink()
    return [file.relative_to(into).as_posix() for file in files]


def _receipt(capture: str, checked: _Checked, inspection: Inspection | None) -> dict[str, Any]:
    """What the client gets and the store keeps."""
    facts = inspection or Inspection("", "", 0, 0, (), None)
    return {
        "capture": capture,
        "name": checked.name,
        "collection": checked.collection,
        "created": datetime.now(UTC).isoformat(timespec="seconds").replace("+00:00", "Z"),
        "bytes": checked.archive.stat().st_size,
        "sha256": checked.sha256,
        "inspected": inspection is not None,
        "kind": facts.kind,
        "format": facts.format,
        "frames": facts.frames,
        "points": facts.points,
        "warnings": list(facts.warnings),
        "files": [verdict.document() for verdict in checked.verdicts],
    }


def _encoded(receipt: dict[str, Any]) -> bytes:
    return json.dumps(receipt, ensure_ascii=False, separators=(",", ":")).encode()


def _no_room() -> Problem:
    return Problem(507, "STORAGE_FULL", "there is no room for the upload", retryable=True, hints=("try again later",))


def _remove_abandoned(staging: Path) -> None:
    for folder in staging.iterdir():
        if time.time() - folder.stat().st_mtime > _ABANDONED_S:
            shutil.rmtree(folder, ignore_errors=True)
