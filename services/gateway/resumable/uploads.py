"""Resumable uploads: received in chunks, each acknowledged once it is on the store and in the database."""

from __future__ import annotations

import asyncio
import logging
import secrets
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import asynccontextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TypeVar

from sqlalchemy.exc import SQLAlchemyError
from starlette.requests import ClientDisconnect

from capture2vr.gateway.database.full_disk import is_disk_full
from capture2vr.gateway.errors import Problem, storage_full
from capture2vr.gateway.jobs.capture_objects import delete_unfinished, new_capture, put_private
from capture2vr.gateway.resumable.chunk_objects import CHUNK_BYTES, chunk_name, delete_chunks, read_chunks
from capture2vr.gateway.resumable.protocol import MEDIA_TYPE, Checksum
from capture2vr.gateway.resumable.store import LEASE_S, Chunk, Upload, UploadStore
from capture2vr.gateway.uploads.receive import UploadBody
from capture2vr.sentences.sentence import say
from capture2vr.storage.store import Store

_THREADS = 3  # that write chunks: more would take the cores from other requests, and send no faster
_FORM_FIELDS = ("name", "collection")

_log = logging.getLogger(__name__)

_T = TypeVar("_T")


@dataclass(frozen=True, slots=True)
class Part:
    """A request's body that goes on with an upload.

    before_chunk  called before each chunk is stored, with the bytes that it has; raises Problem to refuse it
    on_stored     called after each chunk with its bytes
    """

    batches: AsyncIterator[bytes]
    checksum: Checksum | None
    before_chunk: Callable[[int], Awaitable[None]]
    on_stored: Callable[[int], Awaitable[None]]


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
            raise _locked(say("continued_by_another_request_meanwhile"))
        receiver = _Receiver(self, upload, writer, part, store)
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
            raise _locked(say("capture_being_made"))
        renewing = asyncio.create_task(self._renew(upload.id, finisher))
        try:
            yield held
        finally:
            renewing.cancel()
            await asyncio.shield(self.run(lambda: self.database.renew(upload.id, finisher, 0.0)))

    async def remove(self, upload: Upload, store: Store) -> None:
        """Remove an upload and its bytes for good; a capture that it became stays. Raises Problem UPLOAD_LOCKED."""
        if not await self.run(lambda: self.database.remove(upload, time.time())):
            raise _locked(say("capture_being_made"))
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


class _Receiver:
    """Writes one request's body to chunks of an upload."""

    def __init__(self, uploads: ResumableUploads, upload: Upload, writer: str, part: Part, store: Store) -> None:
        self._uploads = uploads
        self._upload = upload
        self._writer = writer
        self._part = part
        self._store = store
        self._end = upload.received  # of what is in chunks on the store
        self._spool = uploads.new_spool()
        self._spooled = 0  # bytes
        self._held: list[Chunk] = []  # on the store, but not acknowledged yet
        self._hasher = part.checksum.hasher() if part.checksum else None

    async def receive(self) -> None:
        checksum = self._part.checksum
        failure = await self._fill()
        if failure is not None and checksum is not None:
            raise failure
        await self._store_chunk()
        if failure is not None:
            raise failure
        if checksum is not None and self._hasher is not None:
            checksum.check(self._hasher.digest())
            await self._acknowledge()

    async def _fill(self) -> Exception | None:
        """Receive the body; return what ended it early. What came before is good then."""
        batches = aiter(self._part.batches)
        while True:
            try:
                batch = await anext(batches)
            except StopAsyncIteration:
                return None
            except (Problem, ClientDisconnect) as failure:
                return failure
            if self._end + self._spooled + len(batch) > self._upload.length:
                return too_long(self._upload.length)
            await self._uploads.on_thread(partial(self._write, batch))
            if self._spooled >= self._uploads.chunk_bytes:
                await self._store_chunk()

    async def close(self) -> None:
        """Remove the temporary file, and chunks that were not acknowledged.

        A chunk that the store does not delete now goes with the upload's others, once it is finished or expires.
        """
        self._spool.unlink(missing_ok=True)
        for chunk in self._held:
            name = chunk_name(self._upload.id, chunk)
            try:
                await self._uploads.on_thread(partial(self._store.delete, name))
            except OSError as error:
                _log.warning("%s is left on the store for now: %s", name, error)

    def _write(self, batch: bytes) -> None:
        with self._spool.open("ab") as file:
            file.write(batch)
        self._spooled += len(batch)
        if self._hasher is not None:
            self._hasher.update(batch)

    async def _store_chunk(self) -> None:
        """Store the spooled bytes as a chunk, and acknowledge it unless the checksum is still to be checked."""
        if not self._spooled:
            return
        await self._part.before_chunk(self._spooled)
        chunk = Chunk(self._end, self._spooled, self._writer)
        self._held.append(chunk)  # before it is stored: on a failure it is deleted
        await self._uploads.on_thread(lambda: self._put(chunk))
        self._end, self._spooled = self._end + self._spooled, 0
        if self._part.checksum is None:
            await self._acknowledge()

    def _put(self, chunk: Chunk) -> None:
        put_private(self._store, chunk_name(self._upload.id, chunk), self._spool, MEDIA_TYPE)
        self._spool.unlink()  # the store may have a link to it: the next chunk is another file

    async def _acknowledge(self) -> None:
        """Acknowledge the chunks that are held. Raises Problem UPLOAD_LOCKED."""
        if not self._held:
            return
        # Not held while the database decides: were this cancelled just then, `close` would delete what is acknowledged.
        chunks, self._held = self._held, []
        database, expires = self._uploads.database, self._uploads.expiry()
        if not await self._uploads.run(lambda: database.append(self._upload.id, chunks, expires)):
            self._held = chunks
            raise _locked(say("continued_by_another_request_meanwhile"))
        await self._part.on_stored(sum(chunk.length for chunk in chunks))


def content_of(metadata: Mapping[str, str]) -> tuple[str, str]:
    """Return the media type of an upload's bytes, and the name of the one file that they are; "" for a form."""
    media_type = metadata.get("filetype") or "application/octet-stream"
    return media_type, "" if media_type.startswith("multipart/") else metadata.get("filename", "")


def too_long(length: int) -> Problem:
    """Return the problem for more bytes than an upload was created for, which is `length`."""
    detail = say("upload_has_bytes", length=length)
    return Problem(413, "UPLOAD_TOO_LONG", detail, hints=("ask with HEAD how far it is, and send the rest alone",))


def _locked(why: str) -> Problem:
    hints = (say("ask_with_head_how_far"),)
    detail = say("upload_cannot_be_changed_now", why=why)
    return Problem(423, "UPLOAD_LOCKED", detail, retryable=True, hints=hints, headers={"Retry-After": "2"})
