"""Resumable uploads: received in chunks, each acknowledged once it is on the store and in the database."""

from __future__ import annotations

import asyncio
import logging
import secrets
import time
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import asynccontextmanager
from pathlib import Path
from typing import TypeVar

from sqlalchemy.exc import SQLAlchemyError

from capture2vr.gateway.database.full_disk import is_disk_full
from capture2vr.gateway.errors import Problem, storage_full
from capture2vr.gateway.jobs.capture_objects import delete_unfinished, new_capture
from capture2vr.gateway.resumable.chunk_objects import CHUNK_BYTES, delete_chunks, read_chunks
from capture2vr.gateway.resumable.receiver import Part, Receiver, locked
from capture2vr.gateway.resumable.store import LEASE_S, Chunk, Upload, UploadStore
from capture2vr.gateway.uploads.receive import UploadBody
from capture2vr.sentences.sentence import say
from capture2vr.storage.store import Store

_THREADS = 3  # that write chunks: more would take the cores from other requests, and send no faster
_FORM_FIELDS = ("name", "collection")

_log = logging.getLogger(__name__)

_T = TypeVar("_T")


class ResumableUploads:
    """Receives, finishes and removes uploads. Event loop only; the database's and the store's work is done on threads.

    chunk_bytes  after so many received bytes they are acknowledged
    """

    def __init__(self, database: UploadStore, staging: Path, expires_s: float) -> None:
        self.database = database
        self.chunk_bytes = CHUNK_BYTES
        self._expires_s = expires_s
        self._staging = staging
        # One thread for the database, as SQLite has one writer; chunks wait for their disk elsewhere.
        self._rows = ThreadPoolExecutor(1, "uploads-rows")
        self._chunks = ThreadPoolExecutor(_THREADS, "uploads-chunks")
        staging.mkdir(parents=True, exist_ok=True)

    def close(self) -> None:
        """Wait for calls in progress, then end the threads."""
        self._rows.shutdown()
        self._chunks.shutdown()

    async def run(self, work: Callable[[], _T]) -> _T:
        """Run a call of the upload store on a thread."""
        return await asyncio.get_running_loop().run_in_executor(self._rows, work)

    def expiry(self) -> float:
        """Return when an upload expires that has received bytes now."""
        return time.time() + self._expires_s

    async def find(self, tenant: str, upload: str) -> Upload:
        """Return a tenant's upload. Raises Problem UPLOAD_UNKNOWN."""
        found = await self.run(lambda: self.database.get(tenant, upload, time.time()))
        if found is None:
            hints = (say("may_have_expired_begin_new"),)
            raise Problem(404, "UPLOAD_UNKNOWN", say("no_upload", upload=upload), hints=hints)
        return found

    async def append(self, upload: Upload, part: Part, store: Store) -> Upload:
        """Append a body to an upload, and return how far it is now.

        What came before the client left or the body was refused is kept; with a checksum all of it or nothing.
        Raises Problem UPLOAD_LOCKED, UPLOAD_TOO_LONG, UPLOAD_CHECKSUM, and what `part` raises.
        """
        writer = secrets.token_hex(8)
        if not await self.run(lambda: self.database.take_over(upload, writer)):
            raise locked(say("continued_by_another_request_meanwhile"))
        receiver = Receiver(self, upload, writer, part, store)
        try:
            await receiver.receive()
        except OSError as error:
            if is_disk_full(error):
                raise storage_full() from None
            raise
        finally:
            await receiver.close()
        return await self.find(upload.tenant, upload.id)

    def body_of(self, upload: Upload, chunks: Sequence[Chunk], store: Store) -> UploadBody:
        """Return the bytes of a complete upload as the body of a capture's upload."""
        media_type, name = content_of(upload.metadata)
        fields = {field: upload.metadata[field] for field in _FORM_FIELDS if field in upload.metadata}
        return UploadBody(read_chunks(store, upload.id, chunks), media_type, upload.length, name, fields)

    @asynccontextmanager
    async def finishing(self, upload: Upload) -> AsyncIterator[Upload]:
        """Hold the lease of making an upload's capture, and give it up at the end; yields the upload with its capture.

        Raises Problem UPLOAD_INCOMPLETE, UPLOAD_LOCKED.
        """
        if upload.received < upload.length:
            detail = say("bytes_upload_have_arrived", received=upload.received, length=upload.length)
            raise Problem(409, "UPLOAD_INCOMPLETE", detail, hints=(say("send_rest_first"),))
        finisher, capture = secrets.token_hex(8), new_capture()
        held = await self.run(lambda: self.database.lease(upload, finisher, capture, time.time()))
        if held is None:
            raise locked(say("capture_being_made"))
        renewing = asyncio.create_task(self._renew(upload.id, finisher))
        try:
            yield held
        finally:
            renewing.cancel()
            await asyncio.shield(self.run(lambda: self.database.renew(upload.id, finisher, 0.0)))

    async def remove(self, upload: Upload, store: Store) -> None:
        """Remove an upload and its bytes for good; a capture that it became stays. Raises Problem UPLOAD_LOCKED."""
        if not await self.run(lambda: self.database.remove(upload, time.time())):
            raise locked(say("capture_being_made"))
        await self.discard_capture(upload, store)
        await self.sweep(upload, store)

    async def discard_capture(self, upload: Upload, store: Store) -> None:
        """Delete the archive of a capture whose making a crash ended before its receipt was stored."""
        if upload.capture and not upload.finished:
            await self.on_thread(lambda: delete_unfinished(store, upload.capture))

    async def sweep(self, upload: Upload, store: Store, kept_since: float = 0.0) -> None:
        """Delete the chunks of an upload that has ended, and forget one that ended before `kept_since`.

        What fails is logged: `Expiry` does it again.
        """
        try:
            await self.on_thread(lambda: delete_chunks(store, upload.id))
            await self.run(lambda: self.database.swept(upload.id, kept_since))
        except (OSError, SQLAlchemyError) as error:
            _log.warning("chunks of %s are left on the store for now: %s", upload.id, error)

    async def on_thread(self, work: Callable[[], _T]) -> _T:
        """Run a call of the object store or a write to the disk on a thread."""
        return await asyncio.get_running_loop().run_in_executor(self._chunks, work)

    def new_spool(self) -> Path:
        """Return the path of a new temporary file for a chunk."""
        return self._staging / f"chunk-{secrets.token_hex(8)}"

    async def _renew(self, upload: str, finisher: str) -> None:
        while True:
            await asyncio.sleep(LEASE_S / 3)
            try:
                await self.run(lambda: self.database.renew(upload, finisher, time.time() + LEASE_S))
            except SQLAlchemyError as error:
                _log.warning("the lease of %s could not be renewed: %s", upload, error)


def content_of(metadata: Mapping[str, str]) -> tuple[str, str]:
    """Return the media type of an upload's bytes, and the name of the one file that they are; "" for a form."""
    media_type = metadata.get("filetype") or "application/octet-stream"
    return media_type, "" if media_type.startswith("multipart/") else metadata.get("filename", "")
